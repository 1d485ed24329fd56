"""Designs end to end: limits verified by Pinocchio and coal, independently of the design."""

import numpy as np
import pinocchio as pin
import pytest

import lieid_casadi as lieid
from lieid_casadi.excitation import (
    CartesianSpeed,
    SelfCollision,
    Torque,
    capsules_of,
    excite,
    floor,
)
from lieid_casadi.excitation.links import Capsule
from lieid_casadi.robot.pinocchio_model import build_pinocchio

PANDA = lieid.robots.panda()


SPEED = 0.9


@pytest.fixture(scope="module")
def limited():
    """The Panda with every kind of limit; one start."""
    links = capsules_of(PANDA)
    limits = [
        Torque(0.9, dry=0.0, viscous=0.0),
        CartesianSpeed(SPEED),
        floor(capsules=links),
        SelfCollision(0.02, links),
    ]
    return excite(
        lieid.Model(PANDA), criterion="condition", limits=limits, acceleration=5.0, starts=1
    )


@pytest.fixture(scope="module")
def pinocchio_motion(limited):
    """Torques, tool speeds and link poses at 1 kHz by Pinocchio."""

    model = build_pinocchio(PANDA)
    data = model.createData()
    motion = limited.motion(1000.0)
    torques, speeds, poses = [], [], []
    for q, dq, ddq in zip(motion.q, motion.dq, motion.ddq, strict=True):
        torques.append(pin.rnea(model, data, q, dq, ddq).copy())
        pin.forwardKinematics(model, data, q, dq)
        tool = model.getFrameId("tool")
        speeds.append(pin.getFrameVelocity(model, data, tool).linear)
        pin.updateFramePlacements(model, data)
        poses.append([pin.SE3(frame) for frame in data.oMi])
    return motion, np.array(torques), np.linalg.norm(speeds, axis=1), poses


def test_condition_number_matches_pinocchio(limited):
    """σ₁/σ_r of Pinocchio's own regressor, at the samples."""

    assert limited.condition_number < 20.0
    assert limited.quality.rank == 43
    model = build_pinocchio(PANDA)
    data = model.createData()
    motion = limited.trajectory.at(0.2 * np.arange(100))
    stacked = np.vstack(
        [
            pin.computeJointTorqueRegressor(model, data, *signals)
            for signals in zip(motion.q, motion.dq, motion.ddq, strict=True)
        ]
    )
    sizes = np.linalg.svd(stacked, compute_uv=False)
    assert np.isclose(limited.condition_number, sizes[0] / sizes[42], rtol=1e-8)
    assert sizes[43] < 1e-8 * sizes[0]
    base = stacked[:, limited.model.base.kept]
    assert np.isclose(limited.neg_log_det, -np.linalg.slogdet(base.T @ base)[1])


def test_joint_limits_hold_at_the_control_rate(limited, pinocchio_motion):
    motion = pinocchio_motion[0]
    assert np.all(motion.q >= PANDA.limit("position_lower"))
    assert np.all(motion.q <= PANDA.limit("position_upper"))
    assert np.all(np.abs(motion.dq) <= PANDA.limit("velocity"))
    assert np.all(np.abs(motion.ddq) <= 5.0)
    assert limited.max_violation == 0.0


def test_torque_speed_and_floor_hold(pinocchio_motion):
    _, torques, speeds, poses = pinocchio_motion
    assert np.all(np.abs(torques) <= 0.9 * PANDA.limit("torque"))
    assert speeds.max() <= SPEED
    for pose in poses[::10]:
        for capsule in capsules_of(PANDA):
            if capsule.link >= 2:
                for end in (capsule.start, capsule.end):
                    assert pose[capsule.link].act(end)[2] >= capsule.radius


def test_links_keep_the_clearance_by_exact_distances(pinocchio_motion):
    import coal

    links = {capsule.link: capsule for capsule in capsules_of(PANDA)}
    kept = SelfCollision(0.02, tuple(links.values())).on(PANDA).labels
    pairs = [(a, b) for a in links for b in links if f"{name(a)} from {name(b)}" in " ".join(kept)]
    assert {(0, 6), (1, 6), (2, 7), (3, 7)} <= set(pairs)
    nearest = min(
        distance(coal, pose, links[a], links[b])
        for pose in pinocchio_motion[3][::25]
        for a, b in pairs
    )
    assert nearest >= 0.02


def name(link):
    return "the base" if link == 0 else f"link {link}"


def distance(coal, pose, a, b):
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


def test_the_file_begins_and_ends_at_rest_at_the_rest_pose():
    """Position, velocity and acceleration are continuous, from period to period, too."""
    found = excite(
        lieid.Model(lieid.robots.two_link()), duration=6.0, periods=2, starts=1, rate=500.0,
        start_pose=[0.3, -0.4], limits=(), max_iterations=20,
    )  # fmt: skip
    motion = found.motion()
    np.testing.assert_allclose(motion.q[[0, -1]], [[0.3, -0.4]] * 2, atol=1e-9)
    np.testing.assert_allclose(motion.dq[[0, -1]], 0.0, atol=1e-9)
    np.testing.assert_allclose(motion.ddq[[0, -1]], 0.0, atol=1e-7)
    assert motion.t[-1] == pytest.approx(found.duration)
    for low, high in ((motion.q, motion.dq), (motion.dq, motion.ddq)):
        trapezoid = 0.5 * (high[1:] + high[:-1]) / 500.0
        np.testing.assert_allclose(np.diff(low, axis=0), trapezoid, atol=2e-4)


def test_same_seed_same_trajectory():
    model = lieid.Model(lieid.robots.two_link(), effects="coulomb,viscous")
    options = {
        "criterion": "condition", "duration": 6.0, "starts": 2, "seed": 5, "max_iterations": 60,
        "limits": (),
    }  # fmt: skip
    here, again = (excite(model, **options) for _ in range(2))
    np.testing.assert_array_equal(here.trajectory.coefficients, again.trajectory.coefficients)
    assert [s.seed for s in here.starts] == [5, 6]
    best = min(s.condition_number for s in here.starts)
    # the search's smooth signs against the model's own
    assert np.isclose(here.condition_number, best, rtol=0.2)


def test_capsules_that_always_touch_are_left_out():
    base = Capsule(0, np.array([0.0, 0.0, 0.5]), np.array([0.0, 0.0, 0.6]), 5.0)
    limits = SelfCollision(0.0, (base, *capsules_of(PANDA)[-1:])).on(PANDA)
    assert limits.labels == ()
    assert limits.left_out == {"base – link 7": "its capsules touch in 100 % of poses"}
