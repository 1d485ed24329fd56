"""What was false in `checked`, and the verification of a motion, on motions written by hand."""

from dataclasses import replace

import numpy as np
import pytest

import lieid_casadi as lieid
from lieid_casadi.errors import NoSolution
from lieid_casadi.excitation import Obstacle, SelfCollision, Wall, capsules_of, floor
from lieid_casadi.excitation.checks import verify
from lieid_casadi.excitation.limits import motion_range, on_arm, speed_points
from lieid_casadi.excitation.rigid_arm import nearness_to_singular
from lieid_casadi.excitation.trajectory import MotionSamples

ROBOT = lieid.robots.two_link()
PANDA = lieid.robots.panda()


def swing(low, high):
    """The shoulder moves from low to high and back, the elbow rests at 0.5 rad."""
    seconds = 2.0 * np.pi * (high - low)  # 0.5 rad/s at most
    t = np.linspace(0.0, seconds, int(1000.0 * seconds) + 1)
    w, size = 2.0 * np.pi / seconds, 0.5 * (high - low)
    q = np.column_stack([low + size * (1.0 - np.cos(w * t)), np.full(len(t), 0.5)])
    moving = np.array([1.0, 0.0])
    dq, ddq = (size * f[:, None] * moving for f in (w * np.sin(w * t), w**2 * np.cos(w * t)))
    return MotionSamples(t, q, dq, ddq)


def verified(motion, *limits, robot=ROBOT):
    return verify(robot, motion, motion_range(robot), on_arm(limits, robot, None), None)


def test_a_motion_through_the_floor_is_refused():
    """The tool is at 0.5 sin q1 + 0.4 sin(q1 + 0.5), less the capsule's radius of 0.054 m."""
    found = verified(swing(0.3, 1.0), floor())
    assert "floor at 0 m: link 2 (line)" in found.checked
    with pytest.raises(NoSolution, match=r"verification of the motion failed: floor at 0 m, link"):
        verified(swing(-0.3, 1.0), floor())


def test_a_motion_through_an_obstacle_is_refused():
    far, near = (Obstacle((x, -1.0, 0.2), (x + 0.2, 1.0, 2.0), "box") for x in (1.0, 0.5))
    assert any(text.startswith("box: link 1") for text in verified(swing(0.3, 1.0), far).checked)
    with pytest.raises(NoSolution, match="failed: box"):
        verified(swing(0.3, 1.0), near)


def test_a_motion_beyond_a_joint_limit_is_refused():
    """Its greatest speed is 0.5 rad/s."""
    joints = list(ROBOT.joints)
    joints[0] = replace(joints[0], limits=replace(joints[0].limits, velocity=0.499))
    with pytest.raises(NoSolution, match=r"velocity .*, joint 1"):
        verified(swing(-0.5, 0.5), robot=replace(ROBOT, joints=tuple(joints)))


def test_an_arm_that_lies_under_the_floor_in_every_pose():
    with pytest.raises(NoSolution, match="every pose violates a limit: distance of link 1 from"):
        floor(0.3).on(ROBOT)


def test_the_name_of_a_robot_gives_it_no_capsules():
    assert {c.source for c in capsules_of(replace(ROBOT, name="panda"))} == {"line"}
    assert {c.source for c in capsules_of(replace(PANDA, name="arm"))} == {"given"}


@pytest.mark.parametrize(
    "limit", [SelfCollision(), Wall((0.0, 0.0, -1.0), 0.0), Obstacle((0.5, 0, 0), (0.6, 1, 1))]
)
def test_limits_without_capsules_use_those_of_the_robot(limit):
    """Not thin lines: the distances are those with the capsules of `capsules_of`."""
    q = np.random.default_rng(0).uniform(-1.0, 1.0, (20, 7))
    motion = MotionSamples(np.zeros(20), q, 0.0 * q, 0.0 * q)
    own, given = (x.on(PANDA) for x in (limit, replace(limit, capsules=capsules_of(PANDA))))
    np.testing.assert_array_equal(own.values(motion), given.values(motion))


URDF = """<robot name="r"><link name="base"/><link name="upper"/><link name="fore"/>
  <link name="tool0"/>
  <joint name="a" type="revolute"><parent link="base"/><child link="upper"/><axis xyz="0 1 0"/>
    <origin xyz="0 0 0.5"/><limit lower="-1" upper="1" velocity="2"/></joint>
  <joint name="b" type="revolute"><parent link="upper"/><child link="fore"/><axis xyz="0 1 0"/>
    <origin xyz="0.3 0 0"/><limit lower="-1" upper="1" velocity="2"/></joint>
  <joint name="c" type="fixed"><parent link="fore"/><child link="tool0"/>
    <origin xyz="0.2 0 0"/></joint></robot>"""


def test_a_urdf_without_effort_and_with_a_frame_beyond_the_tip():
    robot = lieid.Robot.parse_urdf(URDF, tip="fore")
    names = [name for name, _, _ in speed_points(robot)]
    assert names == ["centre of joint 1", "centre of joint 2", "tool", "frame tool0"]
    last = capsules_of(robot)[-1]
    np.testing.assert_allclose(last.end, [0.2, 0.0, 0.0], atol=1e-12)
    assert type(lieid.default_limits(robot)[0]).__name__ == "CartesianSpeed"


def test_rest_poses_are_not_singular():
    """σ_min of the planar Jacobian by its closed form: |l1 l2 sin q2| / σ_max."""
    found = lieid.excite(lieid.Model(ROBOT), duration=6.0, starts=1, max_iterations=5, limits=())
    assert abs(np.sin(found.rest_pose[1])) > 0.05
    assert any(text.startswith("rest pose") for text in found.checked)
    q = np.array([[0.3, 0.0], [0.3, 0.4], [-1.0, 1.5]])
    jacobians = [
        [[-0.5 * np.sin(a) - 0.4 * np.sin(a + b), -0.4 * np.sin(a + b)],
         [0.5 * np.cos(a) + 0.4 * np.cos(a + b), 0.4 * np.cos(a + b)]] for a, b in q
    ]  # fmt: skip
    expected = np.linalg.svd(np.array(jacobians), compute_uv=False)[:, -1]
    near = nearness_to_singular(ROBOT, q)
    np.testing.assert_allclose(near / near[2], expected / expected[2], atol=1e-9)
    stated = lieid.excite(
        lieid.Model(ROBOT), duration=6.0, starts=1, max_iterations=5, limits=(),
        start_pose=[0.3, 0.0],
    )  # fmt: skip
    assert any(text.startswith("rest pose") for text in stated.unchecked)


def test_a_link_of_which_a_part_is_unknown_is_a_line_too():
    """A sphere on the tool's flange says nothing of the link that carries it."""
    ball = '<collision><geometry><sphere radius="0.03"/></geometry></collision>'
    seen = '<visual><geometry><sphere radius="0.1"/></geometry></visual>'
    urdf = URDF.replace('<link name="tool0"/>', f'<link name="tool0">{ball}</link>')
    urdf = urdf.replace('<link name="fore"/>', f'<link name="fore">{seen}</link>')
    sources = [(c.link, c.source) for c in capsules_of(lieid.Robot.parse_urdf(urdf))]
    assert sources == [(2, "shape"), (0, "line"), (1, "line"), (2, "line")]
