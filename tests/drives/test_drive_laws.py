"""Torque of position-controlled drives from their control law."""

import re
from dataclasses import replace

import numpy as np
import pytest
from drives.commanded import LAWS, TWO_LINK, commanded, measured

import lieid_casadi as lieid
from lieid_casadi import plant
from lieid_casadi.cli.main import main
from lieid_casadi.errors import DriveProtectionWarning, RobotError
from lieid_casadi.identification.known_mass import (
    identify_each_stiffness,
    identify_with_known_masses,
)
from lieid_casadi.robot.drive import Drive, commanded_torque, servo_presets
from lieid_casadi.robot.yaml_file import write_yaml

EFFECTS = "coulomb,viscous,offset"
CUTOFF = lieid.Processing(cutoff=8.0)


@pytest.fixture(scope="module")
def run():
    return measured(TWO_LINK)


@pytest.fixture(scope="module")
def commands(run):
    return commanded(run, LAWS)


@pytest.fixture(scope="module")
def folder(commands, run, tmp_path_factory):
    made = tmp_path_factory.mktemp("commands")
    commands.save(made / "run.csv")
    run.save(made / "torque.csv")
    return made


def test_law_of_a_pd_controller(commands, run):
    found = commands.with_drives(LAWS)
    np.testing.assert_allclose(found.tau, run.tau, rtol=0, atol=1e-11)


def test_servo_law_is_that_of_a_dc_motor():
    """duty = clip(P e − P_v dq, ±d), torque = k_t/R (V duty − k_e dq)."""
    for name, servo in servo_presets().items():
        law = lieid.servo_drive(name, derivative=0.3)
        error, dq = np.linspace(-2.0, 2.0, 101), np.linspace(-3.0, 5.0, 101)
        per_volt = servo["stall_torque"] / servo["voltage"]
        asked = servo["gain"] * error - 0.3 / (per_volt * servo["voltage"]) * dq
        duty = np.clip(asked, -servo["largest_duty"], servo["largest_duty"])
        back_emf = servo["voltage"] / servo["no_load_speed"]
        expected = per_volt * (servo["voltage"] * duty - back_emf * dq)
        np.testing.assert_allclose(law.torque(error, dq), expected, rtol=1e-12, atol=1e-12)


def test_missing_velocities_are_differences_within_segments():
    t = np.concatenate([np.arange(50) * 0.01, 10.0 + np.arange(50) * 0.01])
    q = np.where(t < 5, 0.3 * t, 2.0 - 0.5 * (t - 10.0))[:, None]
    recording = lieid.Recording.from_arrays(t, q, command=q)
    tau = recording.with_drives([Drive(stiffness=5.0, damping=2.0)]).tau
    np.testing.assert_allclose(tau[:, 0], np.where(t < 5, -0.6, 1.0), atol=1e-9)


def test_commands_identify_the_same_parameters_as_torque(folder, tmp_path):
    options = ["--cutoff", "8", "--effects", "coulomb,viscous,offset"]
    law = ["--stiffness", "120,50", "--damping", "2,0.5"]
    for name, more in (("run", law), ("torque", [])):
        words = ["identify", "two_link", str(folder / f"{name}.csv"), *options, *more]
        assert main([*words, "-o", str(tmp_path / f"{name}.json")]) == 0
    one, other = (lieid.Fit.load(tmp_path / f"{name}.json") for name in ("run", "torque"))
    # derivatives of recordings with commands are of higher order
    np.testing.assert_allclose(one.values, other.values, rtol=2e-3, atol=1e-4)
    assert one.model.robot.drives == tuple(
        law.limited(limit) for law, limit in zip(LAWS, TWO_LINK.limit("torque"), strict=True)
    )
    assert other.model.robot.drives is None


def test_a_robot_file_states_the_drive_law(folder, tmp_path):
    robot = tmp_path / "arm.yaml"
    robot.write_text(write_yaml(TWO_LINK.with_drives(LAWS)))
    assert lieid.Robot.load(robot).drives[0].damping == 2.0
    assert main(["identify", str(robot), str(folder / "run.csv")]) == 0
    servos = TWO_LINK.with_drives([lieid.servo_drive("xl430", derivative=d) for d in (0.0, 0.2)])
    assert lieid.Robot.parse_yaml(write_yaml(servos)).drives == servos.drives


@pytest.mark.parametrize(
    ("drive", "message"),
    [
        ("{servo: nonsense}", "sts3215"),
        ("{damping: 1}", "stiffness"),
        ("{servo: sts3215, stiffness: 1}", "not both"),
        ("{stiffness: 1, damping: -1}", "not negative"),
    ],
)
def test_bad_drives_in_yaml(drive, message):
    text = f"{{name: a, joints: [{{name: j, screw: [0,0,1,0,0,0], drive: {drive}}}]}}"
    with pytest.raises(RobotError, match=message):
        lieid.Robot.parse_yaml(text)


@pytest.fixture(scope="module")
def one_stiffness(run):
    """Commands of one unknown stiffness on both joints."""
    return commanded(run, [Drive(stiffness=80.0, damping=1.6)] * 2)


UNKNOWN = Drive(stiffness=1.0, damping=0.02, relative=True)


def test_unknown_stiffness_gives_parameters_relative_to_it(one_stiffness, run):
    robot = TWO_LINK.with_drives(UNKNOWN)
    model = lieid.Model(robot, EFFECTS)
    relative = lieid.identify(model, one_stiffness.with_drives(robot.drives), processing=CUTOFF)
    absolute = lieid.identify(model, run, processing=CUTOFF)
    np.testing.assert_allclose(80.0 * relative.values, absolute.values, rtol=2e-3, atol=1e-4)
    assert "RelativeTorqueWarning" in {type(w).__name__ for w in relative.warnings}


def test_known_mass_determines_the_stiffness(one_stiffness):
    model = lieid.Model(TWO_LINK.with_drives(UNKNOWN), EFFECTS)
    recording = one_stiffness.with_drives(model.robot.drives)
    first_moment = plant.demo_arm(TWO_LINK, seed=1, hidden=None).parameters[11]
    mass = first_moment / 0.2  # at the nominal centre of mass, which is assumed to be known
    fit = identify_with_known_masses(model, [recording], {"elbow": mass}, processing=CUTOFF)
    assert fit.model.robot.drives[0].stiffness == pytest.approx(80.0, rel=0.02)
    assert fit.model.robot.drives[0].damping == pytest.approx(1.6, rel=0.02)


@pytest.mark.parametrize("stiffness", [(120.0, 50.0), (50.0, 150.0)])
def test_stiffness_of_each_joint_relative_to_the_first(run, tmp_path, stiffness):
    """The law is that of two drives; the fit has the arm's parameters in units of joint 1's K."""
    laws = [Drive(stiffness=k) for k in stiffness]
    commanded(run, laws).save(tmp_path / "run.csv")
    words = ["identify", "two_link", str(tmp_path / "run.csv"), "--effects", EFFECTS]
    words += ["--stiffness", "each", "--cutoff", "8", "-o", str(tmp_path / "fit.json")]
    assert main(words) == 0
    fit = lieid.Fit.load(tmp_path / "fit.json")
    ratio = stiffness[1] / stiffness[0]
    found = [law.stiffness for law in fit.model.robot.drives]
    assert found == pytest.approx([1.0, ratio], rel=0.02)
    absolute = lieid.identify(lieid.Model(TWO_LINK, EFFECTS), run, processing=CUTOFF)
    np.testing.assert_allclose(stiffness[0] * fit.values, absolute.values, rtol=0.1, atol=0.05)
    text = next(str(w) for w in fit.warnings if "relative to that of joint 1" in str(w))
    value, std = (float(x) for x in text.split("joint 2 ")[1].split(" ± "))
    assert abs(value - ratio) < 4.0 * std < 0.1


def test_a_stiffness_that_is_not_determined_is_that_of_joint_1():
    """The second of two joints with parallel axes hardly loads the first: a light link."""
    one, two = TWO_LINK.joints
    light = replace(TWO_LINK, joints=(one, replace(two, link=0.01 * two.link)))
    recording = commanded(measured(light, seconds=10.0), [Drive(stiffness=k) for k in (50.0, 80.0)])
    robot = light.with_drives(Drive(stiffness=1.0, relative=True))
    fit = identify_each_stiffness(lieid.Model(robot, EFFECTS), [recording], processing=CUTOFF)
    text = next(str(w) for w in fit.warnings if "relative to that of joint 1" in str(w))
    assert [law.stiffness for law in fit.model.robot.drives] == [1.0, 1.0]
    assert text.endswith("not determined, and taken as that of joint 1: joint 2")


def test_gains_of_commands_are_stiffnesses():
    payload = plant.Payload(mass=1.0, com=(0.0, 0.05, 0.0), radius=0.05)
    empty, full = (
        commanded(measured(TWO_LINK, seed=k, motion=k + 3, payload=p), LAWS)
        for k, p in enumerate((None, payload))
    )
    gains = lieid.drive_gains(TWO_LINK, empty, full, mass=1.0, processing=CUTOFF)
    assert gains.per == "rad"
    # the damping of the controller appears as viscous friction
    np.testing.assert_allclose(gains.gains, [120.0, 50.0], rtol=0.03)
    assert gains.option is not None
    assert gains.option.startswith("--stiffness ")


PENDULUM = """{name: pendulum, joints: [{name: lift, screw: [0, -1, 0, 0, 0, 0],
  link: {mass: 1, com: [0.3, 0, 0], inertia: [0.01, 0, 0.02, 0, 0, 0.02]}}]}"""


def lifted(law, *, gravity=9.81 * 0.3, inertia=0.11, dry=0.1, viscous=0.2):
    """Return a recording of a pendulum whose servo trips while it holds the load (10 to 13 s)."""
    t, h = np.arange(0.0, 24.0, 1e-3), 1e-3
    command = -0.9 + 0.4 * np.sin(1.7 * t) + 0.3 * np.sin(4.1 * t)
    command[(t > 10.0) & (t < 13.0)] = 0.0
    q, dq, path, since, tripped = -0.9, 0.0, [], 0.0, False
    for k, goal in enumerate(command):
        asked = law.stiffness * (goal - q)
        since = t[k] if abs(asked) <= law.overload else since
        tripped = abs(asked) > law.protective_limit and (
            tripped or t[k] - since >= law.overload_time
        )
        limit = law.protective_limit if tripped else np.inf
        torque = np.clip(asked, -limit, limit) - (law.damping + viscous) * dq
        path.append(q)
        dq += h / inertia * (torque - gravity * np.cos(q) - dry * np.tanh(dq / 1e-2))
        q += h * dq
    rows = slice(None, None, 5)
    return lieid.Recording.from_arrays(t[rows], np.array(path)[rows, None],
                                       command=command[rows, None], name="lift.csv")  # fmt: skip


def test_rows_of_a_servo_whose_overload_protection_acts_are_left_out(tmp_path):
    """It acts a time after the overload began, until less than its own limit is asked for."""
    law = Drive(stiffness=20.0, damping=1.0, overload=2.5, overload_time=1.0, protective_limit=0.8)
    robot = lieid.Robot.parse_yaml(PENDULUM).with_drives(law)
    recording = lifted(law)
    unlimited = replace(law, overload=np.inf)
    wrong, fit = (
        lieid.identify(lieid.Model(robot.with_drives(own), EFFECTS), recording.with_drives([own]))
        for own in (unlimited, law)
    )
    found = {row["name"]: row["value"] for row in fit.parameter_table()}
    assert found["mcx"] == pytest.approx(0.3, rel=0.02)
    assert found["coulomb.f_c"] == pytest.approx(0.1, rel=0.05)
    assert fit.rms_train[0] < 0.1 < 2.0 < wrong.rms_train[0]
    assert not [w for w in wrong.warnings if isinstance(w, DriveProtectionWarning)]
    (warning,) = [str(w) for w in fit.warnings if isinstance(w, DriveProtectionWarning)]
    start, end = re.search(r"joint 1 .*: (\S+) to (\S+) s", warning).groups()
    assert (float(start), float(end)) == pytest.approx((11.4, 13.2), abs=0.1)
    fit.save(tmp_path / "fit.json")
    assert lieid.Fit.load(tmp_path / "fit.json").model.robot.drives == (law,)


def test_grippers_of_lerobot_have_a_lower_overload():
    """Of the full torque: 25 % for 2 s, then 20 %, and the arm's servos 80 %."""
    t, error, still = np.arange(0.0, 4.0, 0.01), np.full(400, 0.15), np.zeros(400)
    assert not lieid.servo_drive("sts3215").protected(t, error, still).any()
    gripper = lieid.servo_drive("sts3215_gripper")
    np.testing.assert_array_equal(gripper.protected(t, error, still), t >= 2.0)
    assert not gripper.protected(t, 0.5 * error, still).any()
    low = commanded_torque([gripper], t, error[:, None], still[:, None])[-1, 0]
    assert low == pytest.approx(0.2 * 1.91)
