"""Effects of position-controlled drives, on a plant whose torque is hidden from the program."""

from dataclasses import replace
from functools import cache

import mujoco
import numpy as np
import pytest
from benchmarks import so101
from drives.commanded import LAWS, TWO_LINK, commanded, measured

import lieid_casadi as lieid
from lieid_casadi import plant
from lieid_casadi.cli.main import main
from lieid_casadi.diagnosis import events, gates
from lieid_casadi.diagnosis.folds import folds_of
from lieid_casadi.diagnosis.motion import UnseenMotion
from lieid_casadi.diagnosis.result import motion_table
from lieid_casadi.diagnosis.rows import Rows
from lieid_casadi.diagnosis.step import MotionGain
from lieid_casadi.effects.backlash import place_in_play
from lieid_casadi.effects.registry import make
from lieid_casadi.errors import BoundWarning, DriveLimitWarning, EffectError, NoSolution
from lieid_casadi.identification.identify import default_effects
from lieid_casadi.identification.recording_checks import Source
from lieid_casadi.identification.regression.resolved_shapes import command_error_range
from lieid_casadi.recording import choose_cutoff, process
from lieid_casadi.recording.filtering import lowpass
from lieid_casadi.recording.spectrum import motion_band
from lieid_casadi.robot.yaml_file import write_yaml
from lieid_casadi.simulation.runs import window_errors, with_coefficients
from lieid_casadi.simulation.step import plays_of

ROBOT = TWO_LINK.with_drives(LAWS)
BASE = "coulomb,viscous,offset"
CUTOFF = lieid.Processing(cutoff=8.0)
DELAY, BAND = 0.03, 0.01  # s, rad
NAMES = ("backlash", "back_emf", "command_delay", "deadband", "torque_saturation")


def delayed(recording, joint=1):
    """Return the recording with the commands of a joint sent earlier than they act."""
    command = recording.command.copy()
    command[:, joint] = np.interp(recording.t + DELAY, recording.t, command[:, joint])
    return replace(recording, command=command)


@pytest.mark.parametrize("late", [0.0, 0.013])
def test_held_commands_are_those_of_a_staircase(runs, late):
    """The staircase, low-passed as a continuous signal, at the rows of a 50 Hz recording."""
    hold, fine = 0.02, 40
    t = np.arange(0.0, 12.0, hold / fine)
    command = np.sin(2.0 * np.pi * 2.0 * t[::fine]) + 0.5 * np.sin(2.0 * np.pi * 0.7 * t[::fine])
    # at a step the mean of both of its sides
    rows = [np.maximum(np.floor((t - late) / hold + e).astype(int), 0) for e in (1e-6, -1e-6)]
    stairs = 0.5 * (command[rows[0]] + command[rows[1]])
    acting = lowpass(stairs[:, None], 1.0 / (t[1] - t[0]), 8.0)[::fine, 0]
    segment = replace(process([runs[0]], CUTOFF)[0], t=t[::fine], command=command[:, None])
    found = segment.held_command(0, 0.5 * hold + late, hold)[0]
    parts = segment.held_command(0, 0.5 * hold + late, hold, parts=3)
    np.testing.assert_allclose(parts.mean(axis=0), found, atol=1e-12)
    middle = segment.held_command(0, 0.5 * hold + late, hold / 3)[0]
    np.testing.assert_allclose(parts[1], middle, atol=1e-12)
    straight = np.interp(t[::fine] - 0.5 * hold - late, t[::fine], command)
    inner = slice(50, -50)
    errors = [
        np.abs(lowpass(x[:, None], 1.0 / hold, 8.0)[:, 0] - acting)[inner].max()
        for x in (found, straight)
    ]
    assert errors[0] < 2e-4 < 1e-3 < errors[1]


def with_deadband(recording, joint=1):
    """Return the recording of a controller that needs larger errors for the same torque."""
    command = recording.command.copy()
    error = command[:, joint] - recording.q[:, joint]
    command[:, joint] += BAND * np.sign(error)
    return replace(recording, command=command)


def with_torque(recording):
    return recording.with_drives(ROBOT.drives)


@pytest.fixture(scope="module")
def runs():
    return [commanded(measured(TWO_LINK, seed=k, motion=k + 1), LAWS) for k in range(2)]


def fitted(recording, effect):
    """Return the fit with an effect, and its values by name."""
    fit = lieid.identify(lieid.Model(ROBOT, f"{BASE},{effect}"), recording, processing=CUTOFF)
    return fit, {row["name"]: row["value"] for row in fit.parameter_table()}


def test_delay_of_commands(runs):
    fit, found = fitted(with_torque(delayed(runs[0])), "command_delay:2")
    assert found["command_delay.delta"] == pytest.approx(DELAY, rel=0.03)
    without = lieid.identify(lieid.Model(ROBOT, BASE), with_torque(runs[0]), processing=CUTOFF)
    np.testing.assert_allclose(fit.rms_cv, without.rms_cv, rtol=0.1)


def test_deadband(runs):
    """The value, and the prediction of another recording with it."""
    fit, found = fitted(with_torque(with_deadband(runs[0])), "deadband:2")
    assert found["deadband.d"] == pytest.approx(BAND, rel=0.1)
    other = with_torque(with_deadband(runs[1]))
    assert lieid.compare(fit, other).rms_moving[1] < 2.0 * fit.rms_cv[1]


@cache
def saturated(stated, limit, *, duration=8.0, command_rate=1000.0):
    """Return a recording of a joint whose torque has a limit other than that of its law, N·m."""
    arm = plant.demo_arm(TWO_LINK, seed=1, hidden=None)
    laws = [replace(law, damping=law.damping / 4) for law in LAWS]
    laws[1] = replace(laws[1], proportional_limit=stated)
    drives = [
        plant.PositionDrive(law.stiffness, law.damping, limit=bound)
        for law, bound in zip(laws, (np.inf, limit), strict=True)
    ]
    path = plant.FourierTrajectory(TWO_LINK, base_frequency=0.1, harmonics=5, seed=0)
    run = plant.simulate_commands(
        arm, path, drives, duration=duration, command_rate=command_rate,
        sensors=plant.demo_sensors(TWO_LINK),
    )  # fmt: skip
    return TWO_LINK.with_drives(laws), run.with_drives(laws)


def test_a_limit_that_acts_half_of_the_time_is_found():
    robot, recording = saturated(np.inf, 2.2)
    error = abs(recording.command - recording.q)[:, 1]
    assert np.mean(LAWS[1].stiffness * error > 2.2) > 0.4
    model = lieid.Model(robot, f"{BASE},torque_saturation:2")
    (found,) = lieid.identify(model, recording, processing=CUTOFF).shapes
    assert LAWS[1].stiffness * found == pytest.approx(2.2, rel=0.02)


def test_a_limit_acts_on_late_commands():
    robot, recording = saturated(np.inf, 2.2)
    late = replace(delayed(recording), tau=None).with_drives(robot.drives)
    model = lieid.Model(robot, f"{BASE},command_delay:2,torque_saturation:2")
    fit = lieid.identify(model, late, processing=CUTOFF)
    values = {row["name"]: row["value"] for row in fit.parameter_table()}
    assert LAWS[1].stiffness * values["torque_saturation.e_s"] == pytest.approx(2.2, rel=0.02)
    assert values["command_delay.delta"] == pytest.approx(DELAY, abs=0.002)
    without = lieid.identify(
        lieid.Model(robot, f"{BASE},torque_saturation:2"), recording, processing=CUTOFF
    )
    assert fit.rms_cv[1] < 1.2 * without.rms_cv[1]


def test_the_cutoff_of_laws_leaves_out_the_noise_of_accelerations(runs):
    """White noise of positions is a thousandth of the acceleration's power below the cut-off."""
    accurate = with_torque(runs[0])
    random = np.random.default_rng(0)
    coarse = with_torque(replace(runs[0], q=runs[0].q + 1e-3 * random.normal(size=runs[0].q.shape)))
    low, high = choose_cutoff(coarse), choose_cutoff(accurate)
    assert 2.9 * motion_band(accurate) < low < 0.7 * high
    t, noise = coarse.t, 1e-3 * random.normal(size=coarse.q.shape)
    at = np.arange(t[0], t[-1], 1.0 / coarse.rate)
    frequency = np.fft.rfftfreq(len(at), 1.0 / coarse.rate)
    below = (frequency > 0.0) & (frequency < low)

    def power(x):
        spectrum = np.fft.rfft(np.hanning(len(at))[:, None] * x[: len(at)], axis=0)
        return np.sum(
            (np.abs(spectrum) * (2.0 * np.pi * frequency[:, None]) ** 2)[below] ** 2, axis=0
        )

    assert (power(noise) < 3e-3 * power(accurate.q)).all()


def so101_recording(monkeypatch, case, seed):
    """Return the robot and a recording of the altered SO-101 at 50 Hz with 4096 counts."""
    for name, value in zip(("PLAY", "DELAY", "LIMIT"), so101.CASES[case], strict=True):
        monkeypatch.setattr(so101, name, value)
    monkeypatch.setattr(so101, "SEED", seed)
    return so101.recorded(1, 30.0)[0].with_drives(so101.ROBOT.drives)


def test_delays_of_coarse_positions_and_soft_friction(monkeypatch):
    """Of least squares with noisy accelerations and rows at reversals, 0.008 s more."""
    recording = so101_recording(monkeypatch, "hold", 25)
    fit = lieid.identify(lieid.Model(so101.ROBOT, so101.EFFECTS), recording)
    named = {(row["name"], row["joint"]): row["value"] for row in fit.parameter_table()}
    delays = [named["command_delay.delta", j] for j in range(1, 7)]
    np.testing.assert_allclose(delays, 0.01, atol=0.004)
    altered = so101.altered_model()
    dry = [named["coulomb.f_c", j] for j in range(1, 7)]
    np.testing.assert_allclose(dry, altered.dof_frictionloss, rtol=0.07)


def test_transients_are_judged_by_fits_that_have_a_solution(runs, monkeypatch):
    recording = with_torque(runs[0])
    fit = lieid.identify(lieid.Model(ROBOT, BASE), recording, processing=CUTOFF)

    def fails(*args, **options):
        raise NoSolution("no physically consistent parameters")

    transient = events.Event("contact", Source("run", ""), 1.0, 1.5, (0,), 2.0, "a transient")
    monkeypatch.setattr(events, "transient_events", lambda *args: (transient,))
    monkeypatch.setattr(events, "identify", fails)
    assert events.with_brief_effects(fit, [recording], "feasible") is fit


@pytest.mark.parametrize(("name", "value"), [("backlash.b", 1e-9), ("armature.I_a", 0.0)])
def test_a_play_that_parts_of_the_data_do_not_show_can_be_compared(runs, name, value):
    """Without play, or inertia of the motor, a joint has one angle less: no common simulation."""
    recording = with_torque(runs[0])
    fit = lieid.identify(lieid.Model(ROBOT, f"{BASE},armature,backlash:1"), recording)
    of_motor = {c.name: k for k, c in enumerate(fit.model.columns) if c.joint == 0}
    values = fit.effect_coefficients.copy()
    values[[of_motor["armature.I_a"], of_motor["backlash.b"]]] = 0.01
    values[of_motor[name]] = value  # as uncertain as its sign: some parts lower it to zero
    rows = Rows.of(fit, process([recording], fit.processing), with_candidates=False)
    unseen = UnseenMotion.of(rows, folds_of(rows, rows.residual, 10))
    fits = unseen._fits_without(with_coefficients(fit, values))
    assert [len(plays_of(each)) for each in fits] == [1] * 10


def test_recordings_of_unlike_rates_are_compared_at_the_ends_of_their_windows(runs):
    """As pieces are whose rates differ in the last digits, where contact is left out."""
    fine = with_torque(runs[0])
    signals = {name: getattr(fine, name)[::2] for name in ("t", "q", "dq", "tau", "command")}
    recordings = [fine, replace(fine, name="coarse", **signals)]
    fit = lieid.identify(lieid.Model(ROBOT, f"{BASE},armature"), recordings)
    segments = process(recordings, fit.processing)
    rows = Rows.of(fit, segments, with_candidates=False)
    unseen = UnseenMotion.of(rows, folds_of(rows, rows.residual, 10))
    fits = unseen._fits_without(fit)
    ends = [window_errors([fits[k] for k in own], run, s)[:, -1] for run, s, own in unseen.windows]
    gain = unseen.gain(fit, fit)
    np.testing.assert_allclose(gain.before, np.sqrt(np.mean(np.concatenate(ends) ** 2, axis=0)))
    assert gain.fall == 0.0
    assert [len(of_run) > 0 for of_run in ends] == [True, True]


def test_the_error_of_a_sound_arm_is_noise(monkeypatch):
    """That of coarse positions, which repeats with the motion; of other rows than at reversals."""
    recording = so101_recording(monkeypatch, "hold", 0)
    fit = lieid.identify(lieid.Model(so101.ROBOT, so101.EFFECTS), recording)
    assert not [w for w in fit.warnings if isinstance(w, DriveLimitWarning)]
    compared = lieid.compare(fit, recording)
    assert compared.noise_source == "motion"
    assert (compared.rms_moving < 1.2 * compared.noise_floor).all()


@pytest.mark.slow
def test_limits_of_drives_are_found_first(monkeypatch):
    """They are found as such, and not as effects of the arm that resemble them together."""
    recording = so101_recording(monkeypatch, "saturation", 0)
    model = lieid.Model(so101.ROBOT, so101.EFFECTS)
    found = lieid.diagnose(model, recording, method="feasible")
    assert {s.label for s in found.steps} == {f"torque_saturation:{j}" for j in range(1, 7)}
    assert not [event for event in found.events if event.kind != "standstill"]
    assert found.verdict == "effect_found"
    numbers = (DriveLimitWarning, BoundWarning)  # the first fit's are no longer true
    assert not [w for w in found.warnings if isinstance(w, numbers) and w not in found.fit.warnings]


@pytest.mark.parametrize(
    "stated", [3.3, pytest.param(np.inf, marks=pytest.mark.slow)], ids=["clipped law", "no limit"]
)
def test_saturation_in_a_simulated_arm(stated):
    """A lower limit replaces that of the law, beyond which errors do not act."""
    limit = 2.75
    robot, recording = saturated(stated, limit)
    error = abs(recording.command - recording.q)[:, 1]
    assert (LAWS[1].stiffness * error).max() > 1.1 * limit
    plain = lieid.identify(lieid.Model(robot, BASE), recording, processing=CUTOFF)
    (warning,) = [w for w in plain.warnings if isinstance(w, DriveLimitWarning)]
    assert "joint 2 (" in str(warning)
    assert "torque_saturation:2 " in str(warning)
    model = lieid.Model(robot, f"{BASE},torque_saturation:2")
    fit = lieid.identify(model, recording, processing=CUTOFF)
    assert not [w for w in fit.warnings if isinstance(w, DriveLimitWarning)]
    values = {row["name"]: row["value"] for row in fit.parameter_table()}
    assert fit.rms_cv[1] < 0.7 * plain.rms_cv[1]
    assert values["torque_saturation.K"] == pytest.approx(LAWS[1].stiffness, rel=0.01)
    assert LAWS[1].stiffness * values["torque_saturation.e_s"] == pytest.approx(limit, rel=0.02)
    if not np.isfinite(stated):
        both = lieid.identify(lieid.Model(robot, f"{BASE},torque_saturation"), recording)
        assert both.rms_cv[0] > 0.5 * plain.rms_cv[0]  # the column is not the recorded torque
        assert np.ptp(both.shapes) > 0.0
        edge = command_error_range(process(recording, CUTOFF), 0)[1]
        at_edge = np.array([edge, both.shapes[1]])
        held = lieid.identify(both.model, recording, processing=CUTOFF, held_shapes=at_edge)
        (warning,) = [w for w in held.warnings if isinstance(w, BoundWarning)]
        assert str(warning).startswith("torque_saturation.e_s:1 reached its bound")


@pytest.mark.slow
def test_a_diagnosed_fit_of_method_feasible_is_simulated_and_exported(tmp_path):
    """The guide's chain: diagnose -o better.json, simulate, export."""
    arm, run = saturated(np.inf, 2.75, duration=10.0, command_rate=100.0)
    replace(run, tau=None).save(tmp_path / "run.csv")
    robot, better = tmp_path / "arm.yaml", tmp_path / "better.json"
    robot.write_text(write_yaml(arm))
    words = ["diagnose", str(robot), "--train", str(tmp_path / "run.csv"), "--method", "feasible"]
    assert main([*words, "-o", str(better)]) == 0
    fit = lieid.Fit.load(better)
    assert "torque_saturation:2" in [p.label for p in fit.model.placements]
    for column, value in zip(fit.model.columns, fit.effect_coefficients, strict=True):
        assert column.lower <= value <= column.upper
    words = ["simulate", str(better), str(tmp_path / "run.csv"), "-o", str(tmp_path / "sim.csv")]
    assert main(words) == 0
    assert main(["export", str(better), "--to", "mjcf", "-o", str(tmp_path / "out")]) == 0
    mujoco.MjModel.from_xml_path(str(tmp_path / "out" / "two_link.xml"))


PLAY = 0.03  # rad
ROTORS = (0.06, 0.02)  # kg·m²


def test_a_motor_with_play_needs_an_inertia():
    arm = plant.demo_arm(TWO_LINK, seed=1, hidden=None)
    drives = [plant.PositionDrive(law.stiffness, law.damping, backlash=0.01) for law in LAWS]
    path = plant.FourierTrajectory(TWO_LINK, base_frequency=0.1, harmonics=5, seed=0)
    with pytest.raises(EffectError, match="joint 1: expected an armature"):
        plant.simulate_commands(arm, path, drives, duration=1.0)


@pytest.mark.slow
def test_backlash_is_named():
    """Two masses and a contact in the plant; what the link's impacts cause is no collision."""
    arm = plant.demo_arm(TWO_LINK, seed=4, hidden=None)
    arm = arm.with_effects(*(plant.Armature(j, rotor) for j, rotor in enumerate(ROTORS)))
    drives = [plant.PositionDrive(law.stiffness, law.damping) for law in LAWS]
    drives[1] = replace(drives[1], backlash=PLAY)
    path = plant.FourierTrajectory(TWO_LINK, base_frequency=0.1, harmonics=6, seed=2)
    run = plant.simulate_commands(
        arm, path, drives, duration=10.0, command_rate=1000.0, sensors=plant.demo_sensors(TWO_LINK)
    )
    found = lieid.diagnose(lieid.Model(ROBOT, f"{BASE},armature"), with_torque(run))
    assert [(step.effect, step.joints) for step in found.steps[:1]] == [("backlash", (1,))]
    values = {row["name"]: row["value"] for row in found.fit.parameter_table()}
    assert values["backlash.b"] == pytest.approx(PLAY, rel=0.15)
    assert values["backlash.w"] == pytest.approx(PLAY, rel=0.15)


@pytest.mark.parametrize("play", [1e-3, 0.02, 0.2])
@pytest.mark.parametrize("seed", range(4))
def test_place_in_play(seed, play):
    """The motor stays within the play, and at its side while it pushes the link."""
    random = np.random.default_rng(seed)
    t = np.arange(0.0, 10.0, 0.005)
    acceleration = sum(
        random.normal() * np.sin(2.0 * np.pi * random.uniform(0.1, 2.0) * t + random.uniform(0, 6))
        for _ in range(3)
    )
    place = place_in_play(acceleration, t, play)
    side = place / (0.5 * play)
    assert np.abs(side).max() <= 1.0 + 1e-9
    pushing = (np.abs(side[:-1]) == 1.0) & (acceleration[1:] * side[:-1] > 0.0)
    held = pushing & (acceleration[:-1] * side[:-1] > 0.0)
    np.testing.assert_array_equal(side[1:][held], side[:-1][held])
    np.testing.assert_allclose(place_in_play(-acceleration, t, play), -place, atol=1e-12)


def test_place_in_play_crosses_in_the_time_of_a_free_flight():
    """Under an acceleration a = −c·(t − t0) the play is crossed in the time (6 b/c)^(1/3)."""
    t, slope, play = np.arange(0.0, 4.0, 1e-3), 2.0, 0.05
    place = place_in_play(-slope * (t - 1.0), t, play)
    crossed = t[np.flatnonzero(place <= -0.5 * play)[0]] - 1.0
    assert crossed == pytest.approx((6.0 * play / slope) ** (1.0 / 3.0), abs=2e-3)
    assert (place[t < 1.0] == 0.5 * play).all()


@pytest.mark.parametrize("name", NAMES)
def test_they_need_commands(runs, name):
    recording = replace(with_torque(runs[0]), command=None)
    with pytest.raises(EffectError, match="needs commanded positions"):
        lieid.identify(lieid.Model(ROBOT, f"{BASE},{name}:2"), recording)
    assert make(name).commanded


@pytest.mark.slow
@pytest.mark.parametrize(
    ("change", "effect"), [(delayed, "command_delay"), (with_deadband, "deadband")]
)
def test_the_diagnosis_names_them(runs, change, effect):
    train, test = (with_torque(change(run)) for run in runs)
    found = lieid.diagnose(lieid.Model(ROBOT, BASE), train, test)
    assert [(step.effect, step.joints) for step in found.steps[:1]] == [(effect, (1,))]


def test_the_delay_of_a_joint_that_hardly_moves_is_that_of_the_hold():
    """Its recording does not separate a delay from friction: without the prior it is 0.1 s."""
    t = np.arange(0.0, 10.0, 0.02)
    path = np.sin(t[:, None] * [1.7, 3.0] + [0.0, 1.0]) * [0.8, 0.05] + [0.0, 0.3]
    noise = 1e-3 * np.random.default_rng(1).normal(size=path.shape)
    command = path + 0.02 * np.cos(1.7 * t)[:, None] + noise
    recording = lieid.Recording.from_arrays(t, path + noise[::-1], command=command)
    fit, _ = fitted(with_torque(recording), "armature,command_delay")
    assert fit.model.columns[-1].name == "command_delay.delta"
    assert fit.effect_coefficients[-1] == pytest.approx(0.5 * 0.02 + 0.005, abs=0.005)


def test_rotor_inertia_is_a_default_effect_where_torque_is_that_of_a_law(runs):
    plain = runs[0]
    assert default_effects(ROBOT, [with_torque(plain)]).names[3:] == ("armature", "command_delay")
    measured_torque = replace(with_torque(plain), tau=np.ones_like(plain.q))
    assert "armature" not in default_effects(ROBOT, [measured_torque]).names
    assert "armature" not in default_effects(TWO_LINK, [with_torque(plain)]).names


def test_a_gain_that_shows_at_times_counts_against_a_steady_one():
    """Saturation acts in some windows: their mean square alone would be within its scatter."""
    random = np.random.default_rng(0)
    after, parts = random.normal(size=(40, 1, 1)), np.arange(40) // 4
    before = (
        after
        * np.repeat(random.permutation([20.0, 9.0, 4.0, 2.0, 1.3] + 5 * [1.02]), 4)[:, None, None]
    )
    gain = MotionGain.of(before, after, 1.0, parts)
    assert gain.fall > 2.0 * gain.std
    assert gain.fall == pytest.approx(np.log([20.0, 9.0, 4.0, 2.0, 1.3] + 5 * [1.02]).mean())
    squares = np.mean(before**2 - after**2, axis=(1, 2))
    assert squares.mean() < 2.0 * squares.std(ddof=1) / np.sqrt(40)


def test_an_effect_without_which_the_arm_moves_as_well_is_not_added(runs, monkeypatch):
    """The motion of an arm under commands counts, not the torque of its law alone."""
    train = with_torque(delayed(runs[0]))
    doubtful = MotionGain(np.ones(2), np.ones(2), -0.1, 0.06, 1.0)
    monkeypatch.setattr(UnseenMotion, "gain", lambda self, before, after, joint=None: doubtful)
    found = lieid.diagnose(lieid.Model(ROBOT, BASE), train)
    assert not found.steps
    reasons = " ".join(dict(found.rejected).values())
    assert "is no better with it (its error falls by -10.0 ± 6.0 %)" in reasons


def test_effects_without_a_physically_consistent_fit_are_refused(runs, monkeypatch):
    """Those that the path added last, since the first ones explain most."""
    half = runs[0].rows(0, len(runs[0]) // 2)
    train, fit_of = with_torque(delayed(with_deadband(half), joint=0)), gates.identify_segments

    def only_one(compiled, *others, **options):
        if len(compiled.model.placements) > len(lieid.Model(ROBOT, BASE).placements) + 1:
            raise NoSolution("the solver failed")
        return fit_of(compiled, *others, **options)

    monkeypatch.setattr(gates, "identify_segments", only_one)
    found = lieid.diagnose(lieid.Model(ROBOT, BASE), train)
    assert len(found.steps) <= 1
    assert "no physically consistent fit with it was found" in dict(found.rejected).values()


@pytest.mark.slow
def test_friction_in_mujoco_is_no_dead_band(monkeypatch):
    """By default it opposes the velocity 10 ms later, so that it reverses before the velocity."""
    for name, value in {"PLAY": 0.0, "DELAY": 0.0, "RATE": 250.0, "SEED": 22}.items():
        monkeypatch.setattr(so101, name, value)
    train = so101.recorded(1, 15.0)[0].with_drives(so101.ROBOT.drives)
    found = lieid.diagnose(lieid.Model(so101.ROBOT, so101.EFFECTS), train, method="feasible")
    assert not [step.label for step in found.steps]
    assert found.verdict == "sufficient"


@pytest.mark.slow
def test_errors_in_degrees_stand_beside_those_in_newton_metres(runs):
    train = with_torque(with_deadband(runs[0]))
    found = lieid.diagnose(lieid.Model(ROBOT, BASE), train, method="feasible")
    (step,) = [s for s in found.steps if s.effect == "deadband"]
    assert step.motion.after[1] < 0.7 * step.motion.before[1]
    assert step.motion.fall > 2.0 * step.motion.std
    assert found.to_dict()["steps"][0]["motion"]["before"] == list(found.steps[0].motion.before)
    degrees = np.degrees(found.motion.after)
    shown = motion_table(found).rows[-1]
    np.testing.assert_allclose(shown[1:3], degrees)
    np.testing.assert_allclose(shown[3], np.sqrt(np.mean(degrees**2)))
    assert f"the simulated motion is {np.degrees(step.motion.after[1]):.3g}°" in found.sentence
