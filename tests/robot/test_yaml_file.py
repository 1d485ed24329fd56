import numpy as np
import pytest
from robot.random_arms import random_arm

from lieid_casadi.errors import RobotError
from lieid_casadi.robot import Robot
from lieid_casadi.robot.yaml_file import write_yaml

TWO = """
name: two
joints:
  - name: turn
    screw: [0, 0, 1, 0, 0, 0]
    home: {xyz: [0, 0, 0.3], rpy: [0, 0, 0]}
    limits: {position: [-3.1, 3.1], velocity: 2.0, acceleration: 8.0, torque: 80.0}
    torque_constant: 11.5
    link: {mass: 3.0, com: [0.1, 0, 0.2], inertia: {ixx: 0.02, iyy: 0.03, izz: 0.04, ixz: 1e-3}}
  - name: reach
    screw: [0, 0, 0, 1, 0, 0]
tool: {xyz: [0.2, 0, 0], rpy: [0, 0, 1.5707963267948966]}
"""


def one(line):
    return f"name: one\njoints:\n  - name: turn\n    screw: [0, 0, 1, 0, 0, 0]\n    {line}\n"


def test_every_key_is_read():
    robot = Robot.parse_yaml(TWO)
    turn, reach = robot.joints
    assert (robot.name, turn.name, reach.name) == ("two", "turn", "reach")
    assert turn.revolute
    assert not reach.revolute
    np.testing.assert_array_equal(turn.screw, [0, 0, 1, 0, 0, 0])
    np.testing.assert_array_equal(turn.home[:3, 3], [0, 0, 0.3])
    limits = turn.limits
    assert (limits.position_lower, limits.position_upper) == (-3.1, 3.1)
    assert (limits.velocity, limits.acceleration, limits.torque) == (2.0, 8.0, 80.0)
    assert turn.torque_constant == 11.5
    # about the link frame's origin: central inertia + m(c² − c cᵀ) with c = (0.1, 0, 0.2)
    expected = [3.0, 0.3, 0.0, 0.6, 0.02 + 0.12, 0.0, 0.03 + 0.15, 1e-3 - 0.06, 0.0, 0.04 + 0.03]
    np.testing.assert_allclose(turn.link, expected, rtol=0, atol=1e-15)
    np.testing.assert_array_equal(robot.tool[:3, :3], [[0, -1, 0], [1, 0, 0], [0, 0, 1]])


def test_defaults_of_optional_keys():
    robot = Robot.parse_yaml(TWO)
    reach = robot.joints[1]
    assert reach.link is None
    assert np.isnan([reach.limits.velocity, reach.limits.position_lower]).all()
    assert np.isnan(reach.torque_constant)
    np.testing.assert_array_equal(robot.gravity, [0, 0, -9.81])
    # without `home` the link frame is the base frame at the zero pose
    np.testing.assert_array_equal(reach.home, np.eye(4))
    with pytest.raises(RobotError, match="no inertia stated for reach"):
        _ = robot.link_parameters


@pytest.mark.parametrize(
    "inertia",
    [
        "{ixx: 1, ixy: 0.1, iyy: 2, ixz: 0.2, iyz: 0.3, izz: 3}",
        "[1, 0.1, 2, 0.2, 0.3, 3]",
        "[[1, 0.1, 0.2], [0.1, 2, 0.3], [0.2, 0.3, 3]]",
    ],
)
def test_the_forms_of_an_inertia_mean_the_same(inertia):
    robot = Robot.parse_yaml(one(f"link: {{mass: 1, com: [0, 0, 0], inertia: {inertia}}}"))
    np.testing.assert_array_equal(robot.link_parameters[4:], [1, 0.1, 2, 0.2, 0.3, 3])


@pytest.mark.parametrize("n", [1, 2, 5, 9])
def test_round_trip(n):
    arm = random_arm(np.random.default_rng(n), n)
    back = Robot.parse_yaml(write_yaml(arm))
    assert back.name == arm.name
    np.testing.assert_allclose(back.gravity, arm.gravity, rtol=1e-15)
    np.testing.assert_allclose(back.tool, arm.tool, rtol=0, atol=1e-15)
    for ours, theirs in zip(arm.joints, back.joints, strict=True):
        assert (theirs.name, theirs.limits) == (ours.name, ours.limits)
        np.testing.assert_allclose(theirs.screw, ours.screw, rtol=0, atol=1e-15)
        np.testing.assert_allclose(theirs.home, ours.home, rtol=0, atol=2e-15)
        np.testing.assert_allclose(theirs.link, ours.link, rtol=0, atol=1e-14)


SCREW = "name: one\njoints:\n  - name: turn\n    screw: "
BAD = {
    "empty": ("", "found nothing, expected a mapping"),
    "not YAML": ("name: [1", r"line \d+, column \d+: not YAML"),
    "a key twice": ("name: a\nname: b\njoints: []", "line 2, column 1.*'name' is given twice"),
    "python object": (
        "!!python/object:os.system {}",
        "line 1, column 1: found the tag .*python/object:os.system",
    ),
    "no name": ("joints: []", "found no key 'name', expected the keys name, joints"),
    "no screw": (
        "{name: a, joints: [{name: b}]}",
        r"joints\[0\] \(joint 1\): found no key 'screw', expected the keys name, screw",
    ),
    "ω not unit": (SCREW + "[0, 0, 2, 0, 0, 0]", r"joints\[0\].screw .*\|ω\| = 2, expected 1"),
    "v not of ω": (SCREW + "[0, 0, 1, 0, 0, 0.1]", "ω·v = 0.1, expected 0.*v = −ω × p"),
    "text in a number": (SCREW + "[0, 0, one, 0, 0, 0]", r"screw\[2\].*found 'one', expected a n"),
    "unknown key": (one("lmits: 3"), r"unknown key 'lmits', expected the keys name, screw, home"),
    "position upside down": (
        one("limits: {position: [1, -1]}"),
        r"joints\[0\].limits.position \(joint 1\): found \[1, -1\], expected .*lower < upper",
    ),
    "inertia of three": (
        one("link: {mass: 1, com: [0, 0, 0], inertia: [1, 2, 3]}"),
        r"inertia.*found \[1, 2, 3\], expected ixx, ixy, iyy, ixz, iyz, izz",
    ),
    "deep nesting": ("name: " + "[" * 500 + "]" * 500, "nested deeper than 20 levels"),
    # libyaml reads some hundred characters ahead and may refuse it first
    "very deep nesting": ("name: " + "[" * 5000 + "]" * 5000, "nest(ed deeper|ing depth)"),
    "an alias": ("name: &a [*a]", "found the alias 'a', expected its value"),
    "too long": ("name: " + "x" * 1_000_000, "1000006 characters; expected at most 1000000"),
    "too many joints": (
        "name: a\njoints:\n" + "- {name: b, screw: [0, 0, 1, 0, 0, 0]}\n" * 101,
        "found a list of 101, expected at least one joint and at most 100",
    ),
    "two of one name": (
        "{name: a, joints: [{name: b, screw: [0, 0, 1, 0, 0, 0]},"
        " {name: b, screw: [1, 0, 0, 0, 0, 0]}]}",
        r"joints\[1\].name \(joint 2\): found 'b', the name of joint 1, expected a unique name",
    ),
}


@pytest.mark.parametrize(("text", "message"), BAD.values(), ids=BAD.keys())
def test_bad_input_is_refused_in_one_line(text, message, tmp_path):
    path = tmp_path / "arm.yaml"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(RobotError, match=message) as caught:
        Robot.load(path)
    line = str(caught.value)
    assert line.startswith(f"{path}: ")
    assert "\n" not in line


def test_a_negative_principal_moment_is_a_warning_with_the_joints_name():
    link = "link: {mass: 1, com: [0, 0, 0.5], inertia: {ixx: 1, iyy: 1, izz: -0.25}}"
    (warning,) = Robot.parse_yaml(one(link)).warnings
    assert "joint 1 (turn): the inertia of its link has the negative" in str(warning)
    assert "moment -0.25 kg·m²" in str(warning)


def test_a_large_file_is_not_read(tmp_path):
    path = tmp_path / "arm.yaml"
    with open(path, "wb") as file:
        file.truncate(1 << 34)  # sparse
    with pytest.raises(RobotError, match="larger than 16 MB"):
        Robot.load(path)
