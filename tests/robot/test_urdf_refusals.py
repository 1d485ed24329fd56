"""URDF files that cannot be used are refused in one line that names the link or joint."""

import os

import numpy as np
import pytest

from lieid_casadi.errors import MimicJointWarning, NominalInertiaWarning, RobotError
from lieid_casadi.robot import Robot

LINK = (
    '<link name="fore"><inertial><mass value="1"/><inertia ixx="1" ixy="0" ixz="0" iyy="1" '
    'iyz="0" izz="1"/></inertial></link>'
)
JOINT = (
    '<joint name="turn" type="revolute"><parent link="base"/><child link="fore"/>'
    '<origin xyz="0 0 1"/><axis xyz="0 0 1"/>'
    '<limit lower="-1" upper="1" velocity="2" effort="3"/></joint>'
)


def urdf(link=LINK, joint=JOINT, more=""):
    return f'<robot name="r"><link name="base"/>{link}{joint}{more}</robot>'


def of_joint(old, new):
    assert old in JOINT
    return urdf(joint=JOINT.replace(old, new))


def of_link(old, new):
    assert old in LINK
    return urdf(link=LINK.replace(old, new))


BAD = {
    "mass no number": (of_link('mass value="1"', 'mass value="-"'), "link 'fore': mass value='-'"),
    "mass negative": (of_link('mass value="1"', 'mass value="-2"'), "'fore': mass is -2 kg"),
    "no mass": (of_link('<mass value="1"/>', ""), "'fore': <inertial> has no <mass>"),
    "axis of zero length": (of_joint("0 0 1", "0 0 0"), "joint 'turn': axis .* has length 0"),
    "origin far away": (of_joint('origin xyz="0 0 1"', 'origin xyz="0 0 1e200"'), "'turn': xyz"),
    "limits exchanged": (of_joint('lower="-1"', 'lower="4"'), "'turn': limits lower=4, upper=1"),
    "limit negative": (of_joint('effort="3"', 'effort="-3"'), "joint 'turn': limit effort=-3"),
    "mimic": (
        of_joint("</joint>", '<mimic joint="other" multiplier="2"/></joint>'),
        "joint 'turn' mimics 'other'; expected independent joints: lock it",
    ),
    "joint given twice": (
        urdf(more=JOINT.replace('child link="fore"', 'child link="tip"') + '<link name="tip"/>'),
        "joint name 'turn' is given twice",
    ),
    "an entity": ('<!DOCTYPE r [<!ENTITY a "b">]>' + urdf(), "document type or entity"),
}


@pytest.mark.parametrize(("text", "message"), BAD.values(), ids=BAD.keys())
def test_refused_in_one_line(text, message, capfd):
    with pytest.raises(RobotError, match=message) as caught:
        Robot.parse_urdf(text, origin="arm.urdf")
    assert str(caught.value).startswith("arm.urdf: ")
    assert "\n" not in str(caught.value)
    assert capfd.readouterr() == ("", "")


def test_a_joint_may_have_the_name_of_the_tip_link():
    text = urdf(
        joint=JOINT.replace('"turn"', '"tip"'),
        more='<link name="tip"/><joint name="fix" type="fixed"><parent link="fore"/>'
        '<child link="tip"/><origin xyz="0.5 0 0"/></joint>',
    )
    np.testing.assert_allclose(Robot.parse_urdf(text).tool[:3, 3], [0.5, 0.0, 0.0])


def test_a_mimic_joint_off_the_chain_is_locked():
    finger = JOINT.replace('"turn"', '"finger"').replace('"base"', '"fore"')
    finger = finger.replace('child link="fore"', 'child link="pad"')
    finger = finger.replace("</joint>", '<mimic joint="turn"/></joint>')
    text = urdf(more=finger + '<link name="pad"/>')
    robot = Robot.parse_urdf(text, lock=["finger"], origin="arm.urdf")
    assert [j.name for j in robot.joints] == ["turn"]
    (warning,) = robot.warnings
    assert isinstance(warning, MimicJointWarning)
    assert str(warning).startswith("arm.urdf: joint 'finger' mimics 'turn', which is not modelled")


def test_show_names_the_tip_and_joints_without_limits(tmp_path, capsys):
    from lieid_casadi.cli.main import main

    path = tmp_path / "arm.urdf"
    path.write_text(of_joint('type="revolute"', 'type="continuous"'))
    assert main(["show", str(path)]) == 0
    shown = capsys.readouterr().out
    assert "1 joints, tip fore," in shown
    assert "unlimited" in shown
    assert "nan" not in shown


def test_infinite_limits_are_not_stated():
    robot = Robot.parse_urdf(of_joint('upper="1" velocity="2"', 'upper="inf" velocity="inf"'))
    assert np.isnan(robot.limit("position_upper")).all()
    assert np.isnan(robot.limit("velocity")).all()


def test_a_negative_principal_moment_is_a_warning_with_the_links_name(caplog):
    robot = Robot.parse_urdf(of_link('ixy="0"', 'ixy="3"'))
    (warning,) = robot.warnings
    assert isinstance(warning, NominalInertiaWarning)
    assert "link 'fore': its inertia has the negative principal moment -2" in str(warning)
    assert str(warning) in caplog.text
    assert Robot.parse_urdf(urdf()).warnings == ()


def test_a_moment_above_the_sum_of_the_others_is_a_warning():
    """The moments of a body are sums of squared distances: none exceeds the sum of two others."""
    (warning,) = Robot.parse_urdf(of_link('ixx="1"', 'ixx="2.1"')).warnings
    assert "link 'fore': its inertia has a principal moment of 2.1 kg·m², more than" in str(warning)
    assert Robot.parse_urdf(of_link('ixx="1"', 'ixx="2.02"')).warnings == ()  # printed digits


def test_lines_of_native_libraries_are_discarded(capfd):
    from lieid_casadi.robot.urdf import silenced

    with silenced():
        os.write(2, b"a complaint\n")
        os.write(1, b"a notice\n")
    os.write(2, b"after\n")
    assert capfd.readouterr() == ("", "after\n")


def test_a_very_long_chain_is_refused():
    links = "".join(f'<link name="l{k}"/>' for k in range(1000))
    joints = "".join(
        f'<joint name="j{k}" type="revolute"><parent link="l{k}"/><child link="l{k + 1}"/>'
        '<limit lower="-1" upper="1" effort="1" velocity="1"/></joint>'
        for k in range(999)
    )
    with pytest.raises(RobotError, match="found a chain of 999 joints; expected at most 100"):
        Robot.parse_urdf(f'<robot name="r">{links}{joints}</robot>')


@pytest.mark.parametrize("suffix", ["urdf", "yaml", "xml"])
def test_a_pipe_and_a_name_with_a_null_character_are_refused(tmp_path, suffix):
    os.mkfifo(tmp_path / f"arm.{suffix}")
    with pytest.raises(RobotError, match="is a pipe or a device"):
        Robot.load(tmp_path / f"arm.{suffix}")
    with pytest.raises(RobotError, match="null character"):
        Robot.load(f"arm\0.{suffix}")


def test_a_limit_with_one_bound_has_zero_as_the_other():
    """The default of the format; without both bounds the joint has none."""
    limits = Robot.parse_urdf(of_joint(' upper="1"', "")).joints[0].limits
    assert (limits.position_lower, limits.position_upper) == (-1.0, 0.0)
    limits = Robot.parse_urdf(of_joint('lower="-1" ', "")).joints[0].limits
    assert (limits.position_lower, limits.position_upper) == (0.0, 1.0)
    limits = Robot.parse_urdf(of_joint('lower="-1" upper="1" ', "")).joints[0].limits
    assert np.isnan([limits.position_lower, limits.position_upper]).all()


def test_soft_limits_of_a_safety_controller_narrow_the_range():
    safety = '<safety_controller soft_lower_limit="-0.9" soft_upper_limit="5" k_velocity="1"/>'
    limits = Robot.parse_urdf(of_joint("<limit ", f"{safety}<limit ")).joints[0].limits
    assert (limits.position_lower, limits.position_upper) == (-0.9, 1.0)
    unstated = '<safety_controller k_velocity="1"/>'
    limits = Robot.parse_urdf(of_joint("<limit ", f"{unstated}<limit ")).joints[0].limits
    assert (limits.position_lower, limits.position_upper) == (-1.0, 1.0)
