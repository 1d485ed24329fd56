"""Premises that a recording contradicts are found, on simulated arms; sound ones are not."""

import json
import zlib
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from hidden_effects.arms import load_arm
from hidden_effects.case_setup import Case, draw_setup, with_hidden
from hidden_effects.generator import moved

import lieid_casadi as lieid
from lieid_casadi import plant
from lieid_casadi.cli.main import main
from lieid_casadi.fleet.arm_night import ArmNight, load_night
from lieid_casadi.premises.correction import correction_of, gravity_of, shifted
from lieid_casadi.premises.plain_fit import FreeFit
from lieid_casadi.premises.screen import Errors
from lieid_casadi.robot.yaml_file import write_yaml

ROBOT = load_arm("ur10e")
N = ROBOT.n
SMALL = replace(ROBOT, joints=ROBOT.joints[:3])  # for what commands do with findings


def measured(seed, robot=ROBOT, rate=100.0, frequency=0.05):
    t = np.arange(0.0, 20.0, 1.0 / rate)
    motion = plant.FourierTrajectory(robot, base_frequency=frequency, seed=seed).at(t)
    sensors = replace(plant.demo_sensors(robot), rate=rate)
    arm = plant.demo_arm(robot, hidden=None)
    return plant.measure_along(arm, t, *motion, sensors=sensors, seed=seed, name=f"run{seed}")


@pytest.fixture(scope="module")
def run():
    return measured(1)


def corrected(run, *options):
    """A recording that is as if the options had corrected it."""
    return replace(correction_of(options, run.n).of_recording(run), corrections=())


def without_velocity(run):
    return replace(run, dq=None)


def late(run):
    return replace(run, tau=shifted(run.t, run.tau, -0.04))


def amperes(run):
    return replace(run, tau=run.tau / [15.0, 13.0, 11.0, 10.5, 11.0, 11.5])


def compensated(run):
    gravity = lieid.compile(ROBOT).gravity(run.q, ROBOT.link_parameters)
    return replace(run, tau=run.tau - gravity)


def roughly_compensated(run):
    """The controller's own model has 15 % less than the arm's weight."""
    gravity = lieid.compile(ROBOT).gravity(run.q, ROBOT.link_parameters)
    return replace(run, tau=run.tau - 0.85 * gravity)


def filtered(run):
    dq = np.zeros_like(run.q)
    for k in range(1, len(dq)):
        dq[k] = dq[k - 1] + (run.dq[k] - dq[k - 1]) * 0.01 / 0.2
    return replace(run, dq=dq)


def test_a_sound_arm(run):
    found = lieid.check(ROBOT, run)
    assert found.verdict == "sound", found
    assert found.findings == ()
    assert "gravity_direction" in found.checked
    assert dict(found.not_checkable)["same_motion"]


@pytest.mark.parametrize(
    ("change", "premise", "joints", "value", "remedy"),
    [
        (lambda r: corrected(r, "--joint-order 1 3 2 4 5 6"), "joint_order", (1, 2),
         {"order": [1, 3, 2, 4, 5, 6], "signals": "all"}, "--joint-order 1 3 2 4 5 6"),
        (lambda r: replace(r, tau=r.tau[:, [0, 2, 1, 3, 4, 5]]), "joint_order", (1, 2),
         {"signals": "torque"}, "--columns tau2=tau3,tau3=tau2"),
        (lambda r: corrected(r, "--torque-sign 1 -1 1 1 1 1"), "torque_sign", (1,), {},
         "--torque-sign 1 -1 1 1 1 1"),
        (lambda r: corrected(r, "--joint-sign 1 1 -1 1 1 1"), "joint_sign", (2,), {},
         "--joint-sign 1 1 -1 1 1 1"),
        (lambda r: corrected(r, "--joint-zero 0 1.5708 0 0 0 0"), "joint_zero", (1,),
         {"rad": -1.5708}, "--joint-zero 0 -1.5"),
        (lambda r: corrected(r, "--joint-zero 0 0 0 0 1.5708 0"), "joint_zero", (4,),
         {"rad": -1.5708}, "--joint-zero 0 0 0 0 -1."),
        (lambda r: corrected(r, "--joint-coupling 3-2"), "joint_coupling", (1, 2), {},
         "--joint-coupling 3+2"),
        (amperes, "torque_unit", None, {"factor": 12.0, "unit": "A"}, "--columns i1=tau1"),
        (compensated, "torque_gravity_compensated", None, {}, "record"),
        (roughly_compensated, "torque_gravity_compensated", None, {}, "record"),
        (lambda r: replace(r, t=1e3 * r.t), "time_unit", (), {"unit": "ms"}, "--units ms"),
    ],
)  # fmt: skip
def test_wrong_premises(run, change, premise, joints, value, remedy):
    found = lieid.check(ROBOT, change(run))
    first = found.findings[0]
    assert (found.verdict, first.premise) == ("wrong", premise), found
    assert joints in (None, first.joints)
    assert first.remedy.startswith(remedy)
    for key, expected in value.items():
        if not isinstance(expected, float):
            assert first.value[key] == expected
        else:
            assert first.value[key] == pytest.approx(expected, rel=0.15, abs=0.05)
    assert first.remedy.split(" -")[0] in first.sentence or premise.startswith("torque_g")
    if first.error_after is not None:  # both in the same unit
        assert np.all(
            np.array(first.error_after)[list(first.joints)]
            < np.array(first.error_before)[list(first.joints)]
        )


@pytest.mark.parametrize("masses", [True, False])
def test_reversed_torques_are_certain_by_friction(run, masses):
    """Free masses fit them as well, with negative values; friction that drives is impossible."""
    bare = replace(ROBOT, joints=tuple(replace(j, link=None) for j in ROBOT.joints))
    found = lieid.check(ROBOT if masses else bare, replace(run, tau=-run.tau))
    (first,) = found.findings
    assert (found.verdict, first.premise) == ("wrong", "torque_sign")
    assert "friction would drive" in first.sentence
    assert first.remedy == "--torque-sign -1 -1 -1 -1 -1 -1"


def test_a_coupling_that_its_own_joint_does_not_show_is_none():
    """Torque of joint 5 at low speeds resembles that of a wrist whose motor moves joint 6, too."""
    assert lieid.check(*drawn_run(30006)).findings == ()


@cache
def drawn_run(k):
    """Arm and first recording of a case of the benchmark without hidden effects."""
    case = Case("none", 100 + k)
    setup = draw_setup(case, np.random.default_rng([zlib.crc32(case.name.encode()), 0]), 1.0)
    arm = with_hidden(setup, [], [], run=0)
    made = plant.measure(arm, moved(setup, [arm], 0), setup.sensors, seed=k)
    return load_arm(setup.arm_name), made


def test_small_torques_of_several_joints_show_a_unit():
    """A centre of mass beside the stated one explains each of them, not all."""
    arm, light = drawn_run(5012)
    found = lieid.check(arm, replace(light, tau=light.tau / 12.0))
    assert [f.premise for f in found.findings] == ["torque_unit"]


@pytest.mark.parametrize(
    ("k", "option", "premise"),
    [
        (50019, "--joint-zero 0 0 0 0 0 1.5708", "joint_zero"),  # its torque is 0.3 N·m
        (50004, "--joint-order 5 2 3 4 1 6", "joint_order"),  # joints moved by 0.4 to 0.9 rad
        (50004, "--torque-sign 1 1 1 1 -1 1", "torque_sign"),
        (50008, "--joint-sign -1 1 1 1 1 1", "joint_sign"),  # joints moved by 0.3 to 0.4 rad
    ],
)
def test_what_centres_of_mass_do_not_explain_is_found(k, option, premise):
    """The torque that errors of 10 mm give is that along the recorded motion, not the largest."""
    arm, run = drawn_run(k)
    assert lieid.check(arm, run).verdict == "sound"
    assert lieid.check(arm, corrected(run, option)).findings[0].premise == premise


def test_errors_above_the_variation_of_the_torque_compare_no_hypotheses():
    """Motion that does not determine the free fit: its held-out error is of any size."""

    def errors(*held_out):
        free = FreeFit(np.zeros(1), np.zeros((2, 7)), np.ones(2), np.array(held_out), np.zeros(1))
        return Errors(free, None, np.array([1.0, 0.5]), np.zeros((1, 2)))

    undetermined, other, clear = errors(0.2, 7.4), errors(0.2, 1.1), errors(0.2, 0.1)
    assert other.score(undetermined) == 0.0
    assert clear.score(undetermined) == pytest.approx(np.log(0.2))


def test_joints_that_a_recording_leaves_open_are_listed():
    """On those a wrong premise is no finding; on the others it is."""
    arm, run = drawn_run(50014)
    sound = lieid.check(arm, run)
    assert "joint_zero" in sound.checked
    (hidden,) = [why for p, why in sound.not_checkable if p == "joint_zero" and "90°" in why]
    assert "joints 1, 7 " in hidden
    for j in (6, 5):
        zero = replace(correction_of([], 7), zero=np.eye(7)[j] * np.pi / 2.0)
        found = lieid.check(arm, zero.of_recording(run)).findings
        assert [f.premise for f in found] == ([] if j == 6 else ["joint_zero"])


def test_delays_and_velocities(run):
    first = lieid.check(ROBOT, late(run)).findings[0]
    assert first.premise == "time_offset"
    assert first.value["seconds"] == pytest.approx(0.04, abs=0.01)
    first = lieid.check(ROBOT, filtered(run)).findings[0]
    assert first.premise == "velocity_signal"
    assert first.value["seconds"] == pytest.approx(0.2, abs=0.02)


def test_a_filtered_velocity_of_slow_motion_is_a_doubt():
    """Its error is below 15 % of the velocity, and a filter explains it."""
    slow = measured(1, frequency=0.015)
    assert lieid.check(ROBOT, slow).verdict == "sound"
    first = lieid.check(ROBOT, filtered(slow)).findings[0]
    assert first.premise == "velocity_signal"
    assert first.value["seconds"] == pytest.approx(0.2, abs=0.03)


@pytest.mark.parametrize("rpy", [(0.0, np.pi / 2, 0.0), (np.pi, 0.0, 0.0), (0.0, -0.35, 0.0)])
def test_mounting(run, rpy):
    turned = replace(ROBOT, gravity=gravity_of(rpy))
    found = lieid.check(turned, run)  # it was measured upright
    first = found.findings[0]
    assert (found.verdict, first.premise) == ("wrong", "gravity_direction")
    np.testing.assert_allclose(first.value["gravity"], [0.0, 0.0, -9.81], atol=0.4)
    assert first.error_after[1] < first.error_before[1] / 3.0


def test_a_small_tilt_is_no_more_than_a_doubt(run):
    found = lieid.check(replace(ROBOT, gravity=gravity_of((0.1, 0.0, 0.0))), run)
    assert found.verdict == "doubtful"
    assert found.findings[0].premise == "gravity_direction"


def test_a_recording_of_another_arm():
    """Corrections that lower the error and leave the arm unexplained are none."""
    found = lieid.check(load_arm("rail"), measured(2))
    assert found.verdict == "wrong"
    assert [f.premise for f in found.findings] == ["robot_mismatch"]


def test_without_stated_masses(run):
    bare = replace(ROBOT, joints=tuple(replace(j, link=None) for j in ROBOT.joints))
    found = lieid.check(bare, run)
    assert found.verdict == "sound"
    assert "masses" in dict(found.not_checkable)["torque_unit"]
    swapped = lieid.check(bare, corrected(run, "--joint-order 1 3 2 4 5 6"))
    assert swapped.findings[0].premise == "joint_order"


def test_a_test_that_repeats_the_training(run):
    other = lieid.check(ROBOT, run, test=measured(2))
    assert other.verdict == "sound"
    again = replace(run, t=run.t + 100.0, source_hash="other")
    found = lieid.check(ROBOT, run, test=again)
    assert [f.premise for f in found.findings] == ["same_motion"]
    assert found.findings[0].value["fraction"] > 0.95


def test_damaged_samples(run):
    tau = run.tau.copy()
    tau[500:1500:200, 2] += 300.0
    q = (run.q + np.pi) % (2.0 * np.pi) - np.pi + np.where(np.arange(N) == 1, 2.0 * np.pi, 0.0)
    q[:, 0] = (run.q[:, 0] - run.q[700, 0]) % (2.0 * np.pi)
    found = lieid.check(ROBOT, replace(run, tau=tau, q=q))
    premises = {f.premise for f in found.findings}
    assert {"spikes", "angle_wrapped"} <= premises


def test_a_torque_that_was_not_recorded_hides_the_rest(run):
    found = lieid.check(ROBOT, replace(run, tau=run.tau * [1, 1, 0, 1, 1, 1]))
    (first,) = found.findings
    assert (found.verdict, first.premise, first.joints) == ("doubtful", "clipped", (2,))
    assert "not recorded" in first.sentence


def with_jump(run):
    q = run.q.copy()
    q[1000:, 1] += 0.3
    return replace(run, q=q)


def frozen(run):
    tau = run.tau.copy()
    tau[1200:] = tau[1199]
    return replace(run, tau=tau)


@pytest.mark.parametrize(
    ("change", "premise", "joints", "words"),
    [
        (with_jump, "velocity_signal", (1,), "At t = 9.98"),
        (frozen, "held_samples", (), "from t = 12 s on"),
        (lambda r: replace(r, q=r.q * np.where(np.arange(N) == 2, 180 / np.pi, 1)),
         "position_unit", (2,), "convert q3 "),
    ],
)  # fmt: skip
def test_what_is_wrong_with_a_part_of_a_recording(run, change, premise, joints, words):
    """It is no other arm, and no unit of all joints."""
    made = lieid.check(ROBOT, change(run))
    (found,) = [f for f in made.findings if f.premise == premise]
    assert made.verdict == "wrong"
    assert found.joints == joints
    assert words in found.sentence
    assert "robot_mismatch" not in {f.premise for f in made.findings}


def test_encoder_counts_are_not_taken_for_degrees(run):
    found = lieid.check(ROBOT, replace(run, q=run.q * 2**17 / (2.0 * np.pi)))
    assert "position_unit" not in {f.premise for f in found.findings}


def test_three_wrong_premises_are_corrected_together(run):
    """A mounting that is found while order and sign are wrong is corrected again."""
    wrong = corrected(run, "--joint-order 1 3 2 4 5 6", "--torque-sign 1 1 1 -1 1 1")
    arm = replace(ROBOT, gravity=gravity_of((0.0, np.pi / 2, 0.0)))
    found = lieid.check(arm, wrong)
    assert found.verdict == "wrong"
    assert {f.premise: f.remedy for f in found.findings} == {
        "gravity_direction": "--base-rpy 0 0 0",
        "joint_order": "--joint-order 1 3 2 4 5 6",
        "torque_sign": "--torque-sign 1 1 1 -1 1 1",
    }
    assert "mounted otherwise than stated" in found.findings[0].sentence


@pytest.mark.parametrize(
    ("part", "why"),
    [
        (lambda r: r.rows(0, 300), "shorter than 5 s"),
        (lambda r: replace(r, q=0.0 * r.q, dq=0.0 * r.dq), "no joint moves"),
        (lambda r: replace(r, tau=r.tau * [1, 1, 0, 1, 1, 1]), "a torque is constant"),
    ],
)
def test_recordings_that_show_nothing_are_not_of_another_arm(run, part, why):
    found = lieid.check(ROBOT, part(run))
    assert found.verdict != "wrong"
    assert dict(found.not_checkable)["joint_order"].endswith(why)


def test_what_a_check_needs(run):
    with pytest.raises(lieid.LieidError, match="no torque"):
        lieid.check(ROBOT, replace(run, tau=None))
    with pytest.raises(lieid.LieidError, match="6 joints"):
        lieid.check(lieid.robots.two_link(), run)
    with pytest.raises(lieid.LieidError, match="no recordings"):
        lieid.check(ROBOT, [])


@pytest.fixture(scope="module")
def small_run():
    return measured(1, SMALL)


@pytest.fixture(scope="module")
def folder(small_run, tmp_path_factory):
    path = tmp_path_factory.mktemp("premises")
    (path / "arm.yaml").write_text(write_yaml(SMALL))
    corrected(small_run, "--joint-order 1 3 2").save(path / "swapped.csv")
    small_run.save(path / "good.csv")
    return path


def test_commands_stop_with_status_4(folder, capsys):
    arm, recording = str(folder / "arm.yaml"), str(folder / "swapped.csv")
    fit, result = folder / "fit.json", folder / "result.json"
    assert main(["check", arm, recording, "--json", str(result)]) == 4
    assert '"verdict": "wrong"' in result.read_text()
    assert main(["identify", arm, recording, "-o", str(fit)]) == 4
    assert not fit.exists()
    captured = capsys.readouterr()
    assert "--joint-order 1 3 2" in captured.out
    assert len(captured.err.strip().splitlines()) == 1
    options = ["--despite-check", "-o", str(fit), "--json", str(result)]
    assert main(["identify", arm, recording, *options]) == 0
    assert '"premise": "joint_order"' in result.read_text()


def test_a_fit_remembers_what_corrected_its_recordings(folder, capsys):
    arm, swapped, good = (str(folder / x) for x in ("arm.yaml", "swapped.csv", "good.csv"))
    fit = str(folder / "corrected.json")
    options = ["--joint-order", "1", "3", "2", "--base-rpy", "0", "0", "1"]
    assert main(["identify", arm, swapped, *options, "-o", fit]) == 0
    assert lieid.Fit.load(fit).provenance.corrections == ("--joint-order 1 3 2",)
    assert main(["compare", fit, swapped]) == 0
    found = str(folder / "found.json")
    assert main(["check", fit, good, "--json", found]) == 4
    (finding,) = json.loads(Path(found).read_text())["findings"]
    remedy = finding["remedy"]
    assert remedy == "--joint-order 1 2 3"  # in place of the stored one
    assert "read with --joint-order 1 3 2, which this replaces" in finding["sentence"]
    assert main(["check", fit, good, *remedy.split()]) == 0
    night = ArmNight("A1", "2026-01-05", swapped, "", "f")
    _, read = load_night(night, Path(fit).read_bytes(), Path(swapped))
    np.testing.assert_array_equal(read.tau, lieid.Recording.load(good).tau)
    assert main(["compare", fit, good, "--base-rpy", "0", "0", "0"]) == 2
    assert "mounting" in capsys.readouterr().err


def test_a_fit_remembers_the_columns_of_its_recordings(folder, small_run, tmp_path):
    """They are used where a file has them, as that of the same recorder."""
    order = [0, 2, 1]
    replace(small_run, tau=small_run.tau[:, order]).save(tmp_path / "swapped.csv")
    text = (tmp_path / "swapped.csv").read_text()
    (tmp_path / "renamed.csv").write_text(text.replace("tau2", "effort2").replace("tau3", "tau2"))
    arm, fit = str(folder / "arm.yaml"), str(tmp_path / "fit.json")
    columns = "tau2=tau3,tau3=tau2"
    assert main(["identify", arm, f"{tmp_path}/swapped.csv", "--columns", columns, "-o", fit]) == 0
    assert lieid.Fit.load(fit).provenance.columns == ("tau2=tau3", "tau3=tau2")
    assert main(["check", fit, f"{tmp_path}/swapped.csv"]) == 0
    assert main(["check", fit, str(folder / "good.csv")]) == 4
    assert main(["check", fit, str(folder / "good.csv"), "--columns", "t=t"]) == 0
    assert main(["check", fit, f"{tmp_path}/renamed.csv"]) == 2


def test_remedies_suit_how_a_recording_was_read(folder, small_run, tmp_path):
    """Columns that were stated are stated again, and torque constants are multiplied."""
    arm, found = str(folder / "arm.yaml"), tmp_path / "found.json"

    def remedy(recording, *options):
        assert main(["check", arm, str(recording), *options, "--json", str(found)]) == 4
        (finding,) = json.loads(found.read_text())["findings"]
        assert finding["remedy"] in finding["sentence"]
        return finding["remedy"].split()

    order, named = [0, 2, 1], tmp_path / "named.csv"
    replace(small_run, tau=small_run.tau[:, order]).save(named)
    named.write_text(named.read_text().replace("tau", "eff_"))
    typed = remedy(named, "--columns", "tau=eff_*")
    assert typed == ["--columns", "tau=eff_*,tau2=tau3,tau3=tau2"]
    assert main(["check", arm, str(named), *typed]) == 0
    r = small_run
    currents = lieid.Recording.from_arrays(r.t, r.q, r.dq, current=r.tau / 10.0)
    currents.save(tmp_path / "currents.csv")
    typed = remedy(tmp_path / "currents.csv", "--torque-constants", "1,1,1")
    assert typed[0] == "--torque-constants"
    np.testing.assert_allclose(np.array(typed[1].split(","), float), 10.0, rtol=0.2)
    assert main(["check", arm, str(tmp_path / "currents.csv"), *typed]) == 0


def test_the_mounting_of_a_urdf_is_in_the_fit(tmp_path, run):
    urdf = tmp_path / "arm.urdf"
    urdf.write_text(ROBOT.source.text)
    gravity = gravity_of((0.0, 0.5, 0.0))
    tilted = replace(lieid.Robot.from_urdf(urdf), gravity=gravity)
    lieid.identify(lieid.Model(tilted, ["coulomb"]), run).save(tmp_path / "fit.json")
    loaded = lieid.Fit.load(tmp_path / "fit.json").model.robot
    np.testing.assert_array_equal(loaded.gravity, gravity)
    assert loaded.source is not None


def test_the_delay_of_commands_is_no_premise(run):
    """It is an effect of the model: a torque from the laws of the drives is early by it."""
    early = shifted(run.t, run.tau, 0.04)
    drives = (lieid.Drive(stiffness=1000.0),) * N
    as_measured = replace(run, tau=early)
    commanded = replace(run, tau=None, command=run.q + early / 1000.0).with_drives(drives)
    np.testing.assert_allclose(commanded.tau, early, atol=1e-9)
    names = [f.premise for f in lieid.check(ROBOT, as_measured).findings]
    assert names == ["time_offset"]
    made = lieid.check(ROBOT, commanded)
    assert "time_offset" not in [f.premise for f in made.findings]
    assert "time_offset" in dict(made.not_checkable)
