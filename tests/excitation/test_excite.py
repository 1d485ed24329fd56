"""Designs end to end: limits verified by Pinocchio and coal, independently of the design."""

import pickle
from concurrent.futures import Future, ThreadPoolExecutor

import numpy as np
import pinocchio as pin
import pytest

import lieid_casadi as lieid
from lieid_casadi.errors import ExcitationError, NoSolution
from lieid_casadi.excitation import (
    CartesianSpeed,
    SelfCollision,
    Torque,
    Wall,
    capsules_of,
    excite,
    floor,
)
from lieid_casadi.excitation.limits.capsules import Capsule
from lieid_casadi.plant.rigid import build_pinocchio

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
    import pinocchio as pin

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
    import pinocchio as pin

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


def test_starts_and_ends_at_rest_at_the_start_pose(limited):
    ends = limited.at(np.array([0.0, limited.duration]))
    middle = 0.5 * (PANDA.limit("position_lower") + PANDA.limit("position_upper"))
    np.testing.assert_allclose(ends.q, [middle, middle], atol=1e-9)
    np.testing.assert_allclose(ends.dq, 0.0, atol=1e-9)
    np.testing.assert_allclose(ends.ddq, 0.0, atol=1e-9)
    assert (limited.start, limited.end) == (0.0, 20.0)


def test_free_start_reaches_the_condition_number_of_the_reference(capsys):
    """43 inertial columns, 5 rad/s², free start: condition number near 12; nothing printed."""
    found = excite(
        lieid.Model(PANDA), criterion="condition", limits=(), acceleration=5.0,
        free_start=True, starts=2, margin=1.0,
    )  # fmt: skip
    assert found.condition_number <= 12.5
    assert found.approach.duration > 0.5
    motion = found.motion(500.0)
    np.testing.assert_allclose(motion.q[0], found.rest_pose, atol=1e-9)
    np.testing.assert_allclose(np.diff(motion.q, axis=0), motion.dq[1:] / 500.0, atol=2e-5)
    assert capsys.readouterr().out == ""


@pytest.mark.parametrize("free_start", [False, True])
def test_the_file_begins_and_ends_at_rest_at_the_rest_pose(free_start):
    """Run-in and run-out are smooth: position, velocity and acceleration are continuous."""
    found = excite(
        lieid.Model(lieid.robots.two_link()), duration=6.0, periods=2, starts=1, rate=500.0,
        start_pose=[0.3, -0.4], free_start=free_start, limits=(), max_iterations=30,
    )  # fmt: skip
    motion = found.motion()
    np.testing.assert_allclose(motion.q[[0, -1]], [[0.3, -0.4]] * 2, atol=1e-9)
    np.testing.assert_allclose(motion.dq[[0, -1]], 0.0, atol=1e-9)
    np.testing.assert_allclose(motion.ddq[[0, -1]], 0.0, atol=1e-7)
    assert (found.approach.duration > 0.0) is free_start
    assert motion.t[-1] == pytest.approx(found.duration)
    limits = lieid.robots.two_link().limit("velocity")
    assert np.abs(np.diff(motion.q, axis=0)).max() <= 1.001 * limits.max() / 500.0
    for low, high in ((motion.q, motion.dq), (motion.dq, motion.ddq)):
        trapezoid = 0.5 * (high[1:] + high[:-1]) / 500.0
        np.testing.assert_allclose(np.diff(low, axis=0), trapezoid, atol=2e-4)


def test_limits_that_are_checked_by_default():
    """A planar arm over a floor: a start pose is found, and the arm stays above the base plane."""
    robot = lieid.robots.two_link()
    found = excite(lieid.Model(robot), duration=8.0, starts=1, max_iterations=40)
    motion = found.motion(200.0)
    assert np.all(np.abs(motion.dq) <= 0.8 * robot.limit("velocity") + 1e-9)
    assert "floor" not in found.unchecked
    assert "self-collision" not in found.unchecked
    assert found.to_dict()["unchecked"] == list(found.unchecked)
    model = build_pinocchio(robot)
    data = model.createData()
    for q in motion.q[::10]:
        pin.framesForwardKinematics(model, data, q)
        assert data.oMf[model.getFrameId("tool")].translation[2] > 0.0
    free = excite(lieid.Model(robot), duration=8.0, starts=1, max_iterations=40, limits=())
    assert {"floor", "self-collision", "tool speed", "torque of every joint"} <= set(free.unchecked)


def test_a_start_pose_in_collision_is_refused_before_the_search():
    under_the_floor = [0.0, 1.2, 0.0, -0.2, 0.0, 1.8, 0.0]
    with pytest.raises(NoSolution, match=r"start pose violates a limit at rest: .* from the floor"):
        excite(lieid.Model(PANDA), start_pose=under_the_floor, limits=[floor(0.5)])


def test_periods_repeat():
    found = excite(
        lieid.Model(lieid.robots.two_link()), periods=3, duration=6.0, starts=1, max_iterations=20
    )
    t = np.linspace(0.0, 6.0, 50)
    for k in (1, 2):
        np.testing.assert_allclose(found.at(t + 6.0 * k).q, found.at(t).q, atol=1e-9)
    assert found.end == 18.0


def test_same_seed_same_trajectory_on_any_executor():
    model = lieid.Model(lieid.robots.two_link(), effects="coulomb,viscous")
    options = {
        "criterion": "condition", "duration": 6.0, "starts": 3, "seed": 5, "max_iterations": 60,
        "limits": (),
    }  # fmt: skip
    here = excite(model, **options)
    with ThreadPoolExecutor(2) as threads:
        results = [excite(model, executor=e, **options) for e in (Elsewhere(), threads)]
    for there in results:
        np.testing.assert_array_equal(here.trajectory.coefficients, there.trajectory.coefficients)
        assert [s.seed for s in there.starts] == [5, 6, 7]
    best = min(s.condition_number for s in here.starts)
    # the search's smooth signs against the model's own
    assert np.isclose(here.condition_number, best, rtol=0.2)


class Elsewhere:
    """An executor that passes work through pickle, as another process or machine would."""

    def submit(self, function, *arguments):
        result = Future()
        call = pickle.loads(pickle.dumps((function, arguments)))
        result.set_result(pickle.loads(pickle.dumps(call[0](*call[1]))))
        return result


def test_interrupt_keeps_the_best_feasible_trajectory():
    calls = []

    def progress(stage, fraction):
        calls.append(stage)
        if len(calls) == 40:
            raise KeyboardInterrupt

    found = excite(
        lieid.Model(PANDA),
        criterion="condition",
        starts=3,
        progress=progress,
        limits=[Torque()],
    )
    assert found.interrupted
    assert found.max_violation == 0.0
    assert len(found.starts) == 1
    assert found.to_dict()["interrupted"] is True


def test_interrupt_before_anything_is_feasible():
    def progress(stage, fraction):
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        excite(lieid.Model(PANDA), starts=1, progress=progress, limits=())


def test_infeasible_workspace_names_the_limit():
    ceiling = Wall((0.0, 0.0, 1.0), 0.3, "ceiling")
    with pytest.raises(NoSolution, match=r"no start pose .* from the ceiling is violated"):
        excite(lieid.Model(PANDA), limits=[ceiling], starts=1, max_iterations=20)


def test_torque_limit_below_gravity_is_infeasible():
    with pytest.raises(NoSolution, match="torque of joint"):
        excite(
            lieid.Model(PANDA),
            limits=[Torque(0.05, dry=0.0, viscous=0.0)],
            starts=1,
            max_iterations=20,
        )


def robot_with(**changes):
    from dataclasses import replace

    joints = list(lieid.robots.two_link().joints)
    joints[1] = replace(joints[1], limits=replace(joints[1].limits, **changes))
    return replace(lieid.robots.two_link(), joints=tuple(joints))


@pytest.mark.parametrize(
    ("robot", "options", "message"),
    [
        ({"velocity": np.nan}, {}, "no velocity limit for joint 2"),
        ({"position_lower": 2.0, "position_upper": -2.0}, {}, "joint 2 .* contradict"),
        ({}, {"start_pose": [0.0, 9.0]}, "joint 2 .* at 9, outside its position limits"),
        ({}, {"start_pose": [0.0]}, "start pose: 1 numbers; expected 2"),
        ({}, {"duration": 0.3}, "too short for the acceleration limit of joint"),
        ({}, {"acceleration": [1.0, 2.0, 3.0]}, "3 numbers; expected 1 or 2"),
        ({}, {"acceleration": -1.0}, "expected positive numbers"),
        ({}, {"criterion": "best"}, "expected one of combined"),
        ({}, {"samples": 10}, "samples: 10; expected 44"),
        ({}, {"scaling": "imperial"}, "scaling: 'imperial'"),
        ({}, {"scaling": [1.0, 2.0]}, "expected 20 positive factors"),
        ({}, {"starts": 0}, "starts: 0; expected 1"),
        ({}, {"condition_threshold": 0.5}, "condition_threshold: 0.5; expected at least 1"),
        ({}, {"criterion": "logdet", "condition_threshold": 9.0}, "only the criterion 'combined'"),
        ({}, {"periods": 0}, "periods: 0; expected 1"),
        ({}, {"max_iterations": 0}, "max_iterations: 0; expected 1"),
        ({}, {"seed": -1}, "seed: -1; expected 0"),
        ({}, {"rate": 0.0}, "rate: 0 Hz"),
        ({}, {"rate": 1e12}, "rate: 1e\\+12 Hz gives 2e\\+13 rows .* at most 10000000"),
        ({}, {"periods": 10**8}, "in 100000000 periods of 20 s; expected at most"),
        ({}, {"samples": 10**9}, "samples: 1000000000; .* at most 100000"),
        ({}, {"limits": [CartesianSpeed(0.0)]}, "Cartesian speed: 0"),
    ],
)
def test_bad_requests(robot, options, message):
    with pytest.raises(ExcitationError, match=message):
        excite(lieid.Model(robot_with(**robot)), **options)


def test_a_robot_without_acceleration_limits_or_end_stops():
    robot = robot_with(acceleration=np.nan, position_lower=np.nan, position_upper=np.nan)
    found = excite(lieid.Model(robot), duration=8.0, starts=1, max_iterations=30, limits=())
    assert np.abs(found.motion(200.0).ddq[:, 1]).max() <= 3.0


def test_combined_criterion_improves_log_det():
    """C1's bound on −log det: never much worse than C3's, better than C2's."""
    options = {
        "limits": (), "acceleration": 5.0, "free_start": True, "starts": 1, "margin": 1.0,
    }  # fmt: skip
    model = lieid.Model(PANDA)
    names = "combined", "condition", "hadamard"
    c1, c2, c3 = (excite(model, criterion=name, **options) for name in names)
    assert c1.neg_log_det < c2.neg_log_det
    assert c1.condition_number < 2.0 * c2.condition_number < c3.condition_number


def test_thresholds_of_the_combined_criterion_end_the_search():
    """Eq. 20 as printed: below Δ₁ with −log det at most Δ₂, verified, in fewer iterations."""
    options = {"duration": 6.0, "starts": 1, "criterion": "combined", "limits": ()}
    model = lieid.Model(lieid.robots.two_link())
    full = excite(model, **options)
    threshold = 1.3 * full.condition_number
    bound = full.neg_log_det + 0.5
    early = excite(model, condition_threshold=threshold, neg_log_det_threshold=bound, **options)
    assert full.condition_number < early.condition_number <= threshold
    assert early.neg_log_det <= bound
    assert early.max_violation == 0.0
    assert len(early.history) < len(full.history)


def test_unit_norm_scaling_is_named_and_used():
    model = lieid.Model(lieid.robots.two_link(), effects="coulomb,viscous")
    options = {"duration": 6.0, "starts": 1, "criterion": "condition", "limits": ()}
    scaled = excite(model, scaling="unit_norm", **options)
    plain = excite(model, **options)
    assert scaled.to_dict()["scaling"] == "unit_norm"
    motion = scaled.trajectory.at(0.06 * np.arange(100))
    base = lieid.compile(model).base_regressor(motion.q, motion.dq, motion.ddq).reshape(200, -1)
    assert np.isclose(scaled.condition_number, np.linalg.cond(base / np.linalg.norm(base, axis=0)))
    assert scaled.condition_number < plain.condition_number


def test_prior_scaling_is_named_and_used():
    model = lieid.Model(lieid.robots.two_link())
    options = {
        "duration": 6.0, "starts": 1, "criterion": "condition", "max_iterations": 60,
        "limits": (),
    }  # fmt: skip
    plain, prior = excite(model, **options), excite(model, scaling="prior", **options)
    assert prior.to_dict()["scaling"] == "prior"
    assert prior.condition_number != plain.condition_number


def test_capsules_that_always_touch_are_left_out():
    base = Capsule(0, np.array([0.0, 0.0, 0.5]), np.array([0.0, 0.0, 0.6]), 5.0)
    limits = SelfCollision(0.0, (base, *capsules_of(PANDA)[-1:])).on(PANDA)
    assert limits.labels == ()
    assert limits.left_out == ("distance of the base from link 7",)
