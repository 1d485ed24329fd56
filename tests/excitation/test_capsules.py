"""Capsules: containment, geometry of files, distances by coal; verification of a motion."""

from dataclasses import replace

import coal
import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import lieid_casadi as lieid
from lieid_casadi.errors import NoSolution, RobotError
from lieid_casadi.excitation import (
    Capsule,
    Obstacle,
    SelfCollision,
    capsules_of,
    enclosing,
    excite,
    floor,
    load_capsules,
)
from lieid_casadi.excitation.checks import verify
from lieid_casadi.excitation.limits import motion_range, on_arm, speed_points
from lieid_casadi.excitation.links import collision_shapes, segment_distance_to_points
from lieid_casadi.excitation.rigid_arm import nearness_to_singular
from lieid_casadi.excitation.trajectory import MotionSamples
from lieid_casadi.robot.pinocchio_model import build_pinocchio


def outside(capsule, points):
    """How far each point is outside of a capsule."""
    return segment_distance_to_points(points, capsule.start, capsule.end) - capsule.radius


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 10_000), st.integers(1, 60))
def test_an_enclosing_capsule_contains_all_points(seed, count):
    rng = np.random.default_rng(seed)
    points = rng.normal(size=(count, 3)) * rng.uniform(0.01, 1.0, 3)
    assert outside(enclosing(3, points), points).max() <= 1e-9


def distance(pose, a, b):
    shapes = []
    for capsule in (a, b):
        axis = capsule.end - capsule.start
        length = np.linalg.norm(axis)
        shape = coal.Capsule(capsule.radius, length)
        turn = coal.Transform3s(rotation_to(axis / length), 0.5 * (capsule.start + capsule.end))
        here = coal.Transform3s(pose[capsule.link].rotation, pose[capsule.link].translation)
        shapes += [shape, here * turn]
    return coal.distance(*shapes, coal.DistanceRequest(), coal.DistanceResult())


def rotation_to(direction):
    helper = np.eye(3)[np.argmin(np.abs(direction))]
    x = np.cross(helper, direction)
    x /= np.linalg.norm(x)
    return np.column_stack([x, np.cross(direction, x), direction])


def test_distances_match_coal():
    robot = lieid.robots.panda()
    links = capsules_of(robot)
    limits = SelfCollision(0.0, links).on(robot)
    rng = np.random.default_rng(3)
    low, high = robot.limit("position_lower"), robot.limit("position_upper")
    q = rng.uniform(low, high, (100, 7))
    found = limits.values(MotionSamples(np.zeros(100), q, 0 * q, 0 * q))
    pin_model = build_pinocchio(robot)
    poses = [link_placements(pin_model, x) for x in q]
    pairs = [(a, b) for i, a in enumerate(links) for b in links[i + 1 :] if b.link - a.link > 1]
    exact = np.array([[distance(pose, a, b) for pose in poses] for a, b in pairs])
    # every distance of the set is one of the pairs'; coal is exact outside of penetration
    for row, label in zip(found, limits.labels, strict=True):
        clear = row > 1e-3
        gaps = np.abs(exact[:, clear] - row[clear]).max(axis=1)
        assert gaps.min() < 1e-5, label


def link_placements(model, q):
    data = model.createData()
    pin.forwardKinematics(model, data, q)
    return list(data.oMi)


URDF = """<robot name="boxes">
  <link name="base"><collision><geometry><sphere radius="0.1"/></geometry></collision></link>
  <link name="upper"><inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0"
    iyz="0"/></inertial><collision><origin xyz="0.25 0 0" rpy="0 1.5707963 0"/><geometry>
    <cylinder radius="0.05" length="0.5"/></geometry></collision></link>
  <link name="fore"><inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0"
    iyz="0"/></inertial><collision><origin xyz="0.2 0 0"/><geometry>{shape}</geometry></collision>
    </link>
  <joint name="a" type="revolute"><parent link="base"/><child link="upper"/><axis xyz="0 1 0"/>
    <limit lower="-2" upper="2" velocity="2" effort="50"/></joint>
  <joint name="b" type="revolute"><parent link="upper"/><child link="fore"/>
    <origin xyz="0.5 0 0"/><axis xyz="0 1 0"/>
    <limit lower="-2" upper="2" velocity="2" effort="50"/></joint>
</robot>"""
BOX = '<box size="0.4 0.06 0.08"/>'


def robot_of(tmp_path, shape=BOX):
    path = tmp_path / "arm.urdf"
    path.write_text(URDF.format(shape=shape))
    return lieid.Robot.from_urdf(path)


def test_capsules_contain_the_shapes_of_a_urdf(tmp_path):
    sphere, upper, fore = capsules_of(robot_of(tmp_path))
    assert (sphere.link, upper.link, fore.link) == (0, 1, 2)
    assert np.isclose(sphere.radius, 0.1)
    corners = np.array(np.meshgrid([0, 0.4], [-0.03, 0.03], [-0.04, 0.04])).reshape(3, -1).T
    assert outside(fore, corners).max() <= 1e-9
    assert fore.radius < 0.06
    rim = np.array([[x, 0.05 * np.cos(a), 0.05 * np.sin(a)] for x in (0, 0.5) for a in range(9)])
    assert outside(upper, rim).max() <= 1e-6


def test_capsules_contain_a_mesh_that_is_found(tmp_path, monkeypatch):
    """A tetrahedron as STL in a package."""
    folder = tmp_path / "some_arm"
    folder.mkdir()
    corners = np.array([[0.0, 0.0, 0.0], [0.4, 0.0, 0.02], [0.2, 0.06, 0.0], [0.2, 0.0, 0.08]])
    faces = [(0, 1, 2), (0, 1, 3), (0, 2, 3), (1, 2, 3)]
    lines = ["solid t"]
    for face in faces:
        lines += ["facet normal 0 0 0", "outer loop"]
        lines += ["vertex {} {} {}".format(*corners[k]) for k in face]
        lines += ["endloop", "endfacet"]
    (folder / "fore.stl").write_text("\n".join([*lines, "endsolid t"]))
    monkeypatch.setenv("ROS_PACKAGE_PATH", str(tmp_path))
    robot = robot_of(tmp_path, '<mesh filename="package://some_arm/fore.stl"/>')
    fore = [c for c in capsules_of(robot) if c.link == 2]
    assert len(fore) == 1
    assert outside(fore[0], corners + np.array([0.2, 0.0, 0.0])).max() <= 1e-6


def test_a_link_whose_mesh_is_missing_follows_the_line_between_its_joints(tmp_path):
    robot = robot_of(tmp_path, '<mesh filename="package://nowhere/fore.stl"/>')
    links = capsules_of(robot)
    assert [(c.link, c.source) for c in links] == [(0, "shape"), (1, "shape"), (2, "line")]
    assert collision_shapes(robot)[1] == ("fore",)


ENDS = "start: [0,0,0], end: [0,0,1]"


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("capsules: 3", "capsules: found 3, expected a list"),
        ("capsules: [{link: 1}]", "no key 'start', expected the keys link, start, end, radius"),
        (f"capsules: [{{link: 9, {ENDS}, radius: 1}}]", r"capsules\[0\].link: found 9, expected 0"),
        ("capsules: [{link: 1, start: [0,0], end: [0,0,1], radius: 1}]", "found a list of 2, exp"),
        (f"capsules: [{{link: 1, {ENDS}, radius: 0}}]", "found 0, expected a number > 0"),
    ],
)
def test_bad_capsule_files(tmp_path, text, message):
    path = tmp_path / "links.yaml"
    path.write_text(text)
    with pytest.raises(RobotError, match=message):
        load_capsules(path, lieid.robots.two_link())


def test_links_that_cannot_be_checked_are_listed():
    """Capsules so thick that they always touch, and capsules without geometry."""
    robot = lieid.robots.two_link()
    thick = tuple(Capsule(link, np.zeros(3), np.array([0.1, 0.1, 0.0]), 2.0) for link in (0, 2))
    found = excite(
        lieid.Model(robot), duration=6.0, starts=1, max_iterations=10,
        limits=[SelfCollision(0.02, thick)],
    )  # fmt: skip
    assert "self-collision: base – link 2 (its capsules touch in 100 % of poses)" in found.unchecked
    plain = excite(
        lieid.Model(robot), duration=6.0, starts=1, max_iterations=10, limits=[SelfCollision()]
    )
    assert any("no collision geometry was found" in text for text in plain.unchecked)


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


FRAMES_URDF = """<robot name="r"><link name="base"/><link name="upper"/><link name="fore"/>
  <link name="tool0"/>
  <joint name="a" type="revolute"><parent link="base"/><child link="upper"/><axis xyz="0 1 0"/>
    <origin xyz="0 0 0.5"/><limit lower="-1" upper="1" velocity="2"/></joint>
  <joint name="b" type="revolute"><parent link="upper"/><child link="fore"/><axis xyz="0 1 0"/>
    <origin xyz="0.3 0 0"/><limit lower="-1" upper="1" velocity="2"/></joint>
  <joint name="c" type="fixed"><parent link="fore"/><child link="tool0"/>
    <origin xyz="0.2 0 0"/></joint></robot>"""


def test_a_urdf_without_effort_and_with_a_frame_beyond_the_tip():
    robot = lieid.Robot.parse_urdf(FRAMES_URDF, tip="fore")
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
    urdf = FRAMES_URDF.replace('<link name="tool0"/>', f'<link name="tool0">{ball}</link>')
    urdf = urdf.replace('<link name="fore"/>', f'<link name="fore">{seen}</link>')
    sources = [(c.link, c.source) for c in capsules_of(lieid.Robot.parse_urdf(urdf))]
    assert sources == [(2, "shape"), (0, "line"), (1, "line"), (2, "line")]
