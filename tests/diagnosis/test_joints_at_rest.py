"""A joint that rests hides no effect elsewhere, and what is not known of it is stated as such."""

import json
from dataclasses import replace

import numpy as np
import pytest
from hidden_effects.motions import point_to_point
from plant.recordings import recorded
from scipy.ndimage import gaussian_filter1d

import lieid_casadi as lieid
from lieid_casadi import plant
from lieid_casadi.diagnosis.rows import Rows
from lieid_casadi.diagnosis.smooth_functions import formula_of
from lieid_casadi.recording import process

ROBOT = lieid.robots.two_link()
MODEL = lieid.Model(ROBOT, "coulomb,viscous,offset")
ARM = plant.demo_arm(ROBOT, hidden=None)


def held(arm, seed, joint, **options):
    """Measure an arm along a series in which one joint rests."""
    t = np.arange(0.0, 15.0, 0.002)
    motion = [
        x.copy() for x in plant.FourierTrajectory(ROBOT, base_frequency=1 / 15, seed=seed).at(t)
    ]
    for values, rest in zip(motion, (0.3, 0.0, 0.0), strict=True):
        values[:, joint] = rest
    sensors = plant.demo_sensors(ROBOT)
    return plant.measure_along(arm, t, *motion, sensors=sensors, seed=seed, **options)


def test_a_payload_is_found_beside_a_joint_that_rests():
    fit = lieid.identify(MODEL, recorded(ARM, 1, seconds=15.0))
    loaded = ARM.with_effects(plant.Payload(1.0, (0.02, -0.01, 0.04), 1e-6))
    (step,) = lieid.diagnose(fit, held(loaded, 3, 1)).steps
    assert (step.label, step.joint) == ("payload", 0)
    assert step.confirmed
    assert step.after < 0.2 * step.before


@pytest.fixture(scope="module")
def rested_in_the_test():
    arm = ARM.with_effects(plant.hidden_effect(ARM, "stribeck", 0, strength=2.0))
    return lieid.diagnose(MODEL, recorded(arm, 1, seconds=15.0), held(arm, 2, 0, name="test.csv"))


def test_a_joint_that_rests_in_the_test_confirms_nothing(rested_in_the_test):
    (step,) = rested_in_the_test.steps
    assert (step.label, step.fall.test, step.confirmed) == ("stribeck:1", None, None)
    assert "does not confirm" not in rested_in_the_test.sentence
    json.dumps(rested_in_the_test.to_dict(), allow_nan=False)


def test_what_rests_in_the_test_alone_was_searched(rested_in_the_test):
    assert rested_in_the_test.events == ()


def test_a_test_on_the_training_recording_confirms_nothing():
    arm = ARM.with_effects(plant.hidden_effect(ARM, "stribeck", 0, strength=2.0))
    run = recorded(arm, 1, seconds=15.0, name="a.csv")
    found = lieid.diagnose(MODEL, run, replace(run, name="copy.csv"))
    assert [(step.label, step.confirmed) for step in found.steps] == [("stribeck:1", None)]
    assert found.summary.startswith("On the motion of the training the error")


def one_after_the_other(arm, seed):
    """Measure an arm whose joints move alone, each for four seconds, and exactly rest."""
    random, n = np.random.default_rng(seed), arm.robot.n
    t = np.arange(0.0, 4.0 * n, 0.002)
    q = np.zeros((len(t), n)) + 0.5 * (
        arm.robot.limit("position_lower") + arm.robot.limit("position_upper")
    )
    for joint in range(n):
        own = t[:2000]
        rate = random.uniform(0.5, 2.0)
        bend = np.sin(np.pi * own / 4.0) ** 3 * np.sin(2.0 * np.pi * rate * own)
        q[2000 * joint : 2000 * (joint + 1), joint] += random.uniform(0.2, 0.5) * bend
    dq = np.gradient(q, 0.002, axis=0)
    sensors = plant.Sensors(rate=250.0, torque_noise=0.1)
    motion = q, dq, np.gradient(dq, 0.002, axis=0)
    return plant.measure_along(arm, t, *motion, sensors=sensors, seed=seed)


def test_joints_that_move_one_after_the_other_leave_no_parameter_without_bound():
    """Tails of filters excite the links of resting joints, by a millionth: kilonewton metres."""
    robot = lieid.robots.panda()
    arm = plant.demo_arm(robot, hidden=None)
    fit = lieid.identify(lieid.Model(robot, "coulomb,viscous,offset"), one_after_the_other(arm, 1))
    other = one_after_the_other(arm, 2)
    assert np.all(lieid.compare(fit, other).rms < 0.1 * np.abs(other.tau).max())
    assert np.abs(fit.parameters).max() < 50.0  # 5 are the arm's


def test_a_joint_that_moves_for_an_instant_is_no_candidate():
    """No filtered row of it is free of rest, so that there is nothing to scan a ripple with."""
    robot = lieid.robots.two_link()
    t = np.arange(0.0, 20.0, 0.002)
    step = gaussian_filter1d(0.1 * (t > 10.0), 10)
    q = np.column_stack([np.sin(1.3 * t) + 0.3 * np.sin(3.1 * t), step])
    dq = np.gradient(q, 0.002, axis=0)
    recording = plant.measure_along(
        plant.demo_arm(robot, hidden=None), t, q, dq, np.gradient(dq, 0.002, axis=0),
        sensors=plant.Sensors(rate=200.0, torque_noise=0.3), seed=1,
    )  # fmt: skip
    model, slow = lieid.Model(robot, "coulomb,viscous,offset"), lieid.Processing(cutoff=3.0)
    assert not lieid.diagnose(model, recording, processing=slow).steps


def test_what_training_did_not_move_is_uncertain_on_a_test_that_moves_it():
    """Nothing is known of the friction of the second joint: its error is no missing effect."""
    trained = held(ARM, 1, 1)
    friction = lieid.identify(MODEL, trained).parameter_table()[-3]
    assert (friction["name"], friction["joint"]) == ("viscous.f_v", 2)
    assert friction["std"] > 1.0
    found = lieid.diagnose(MODEL, trained, recorded(ARM, 2, seconds=15.0))
    assert found.verdict == "unexplained"
    assert "which uncertain parameters explain: fit longer or larger motion" in found.sentence


@pytest.mark.parametrize(
    ("effect", "strength", "seeds"),
    [("stribeck", 5.0, (1, 2)), ("load_friction", 5.0, (1, 2)), ("load_friction", 3.0, (5, 6))],
)
def test_an_effect_is_found_where_joints_move_one_after_the_other(effect, strength, seeds):
    """Each held-out part has several stretches of time, so that most have rows of its joint."""
    robot = lieid.robots.panda()
    arm = plant.demo_arm(robot, hidden=None)
    lacking = arm.with_effects(plant.hidden_effect(arm, effect, 1, strength=strength))
    model = lieid.Model(robot, "coulomb,viscous,offset")
    found = lieid.diagnose(model, *(one_after_the_other(lacking, seed) for seed in seeds))
    (step,) = [step for step in found.steps if step.joint == 1]
    assert step.label == f"{effect}:2"
    assert step.fall.test > 0.5 * found.baseline["rms_test_moving"][1]


def each_at_its_own_time(arm, seed, *, joints):
    """Measure, at 50 Hz, joints that move to random goals, each at its own times, with pauses."""
    random, t = np.random.default_rng(seed), np.arange(0.0, 24.0, 0.002)
    lower, upper = arm.robot.limit("position_lower"), arm.robot.limit("position_upper")
    q = np.zeros((len(t), arm.robot.n)) + 0.5 * (lower + upper)
    for joint in joints:
        at, end = 0.0, 0.0
        while end < t[-1]:
            end += random.uniform(0.0, 0.8)
            time, goal = random.uniform(0.3, 1.2), random.uniform(-0.25, 0.25)
            u = np.clip((t - end) / time, 0.0, 1.0)
            way = goal * (upper - lower)[joint] - at
            q[:, joint] += way * (10.0 * u**3 - 15.0 * u**4 + 6.0 * u**5)
            at, end = at + way, end + time
    q = gaussian_filter1d(q, 15, axis=0, mode="nearest")
    dq = np.gradient(q, 0.002, axis=0)
    sensors = plant.Sensors(rate=50.0, torque_noise=0.1)
    motion = q, dq, np.gradient(dq, 0.002, axis=0)
    return plant.measure_along(arm, t, *motion, sensors=sensors, seed=seed)


@pytest.mark.parametrize("seed", [13, 15])
def test_friction_of_rests_is_no_effect_of_low_speeds(seed):
    """A filter adds a part of it to the rows before and after, as less friction near standstill."""
    robot = lieid.robots.panda()
    arm = plant.demo_arm(robot, hidden=None)
    runs = (each_at_its_own_time(arm, k, joints=range(7)) for k in (seed, seed + 1))
    found = lieid.diagnose(lieid.Model(robot, "coulomb,viscous,offset"), *runs)
    assert found.verdict == "sufficient"


@pytest.mark.parametrize("joints", [(1,), (2, 3)])
def test_a_payload_is_found_where_few_joints_move(joints):
    """They show combinations of its mass and first moments, and of the links', that are known."""
    robot = lieid.robots.panda()
    arm = plant.demo_arm(robot, hidden=None)
    model = lieid.Model(robot, "coulomb,viscous,offset")
    fit = lieid.identify(model, each_at_its_own_time(arm, 3, joints=joints))
    loaded = arm.with_effects(plant.Payload(1.0, (0.02, -0.01, 0.04), 1e-6))
    found = lieid.diagnose(fit, each_at_its_own_time(loaded, 2, joints=joints))
    assert [step.label for step in found.steps] == ["payload"]
    for joint in joints:
        assert found.steps[0].errors["rms_test_moving"][joint] < 0.3
    assert not lieid.diagnose(fit, each_at_its_own_time(arm, 4, joints=joints)).steps


def test_an_effect_of_the_library_is_found_where_functions_do_not_extend():
    """Chirps: every held-out part has frequencies of its own, to which no function extends."""
    robot = lieid.robots.panda()
    arm = plant.demo_arm(robot, hidden=None)
    lacking = arm.with_effects(plant.hidden_effect(arm, "load_friction", 1, strength=4.0))
    runs = (chirps(lacking, seed) for seed in (1, 2))
    found = lieid.diagnose(lieid.Model(robot, "coulomb,viscous,offset"), *runs)
    assert found.steps[0].label == "load_friction:2"
    assert (
        found.steps[-1].errors["rms_test_moving"][1] < 0.05 * found.baseline["rms_test_moving"][1]
    )


def chirps(arm, seed):
    """Measure joints that swing ever faster, or ever slower, for 20 s."""
    random, t = np.random.default_rng(seed), np.arange(0.0, 20.0, 0.002)
    robot = arm.robot
    span = robot.limit("position_upper") - robot.limit("position_lower")
    q = np.zeros((len(t), robot.n)) + robot.limit("position_lower") + 0.5 * span
    for joint in range(robot.n):
        f = np.linspace(0.1, 1.5, len(t))
        f = f if random.random() < 0.5 else f[::-1]
        phase = 2.0 * np.pi * np.cumsum(f) * 0.002 + random.uniform(0.0, 6.0)
        size = 0.5 * robot.limit("velocity")[joint] / (2.0 * np.pi * f)
        q[:, joint] += np.minimum(0.15 * span[joint], size) * np.sin(phase)
    q = gaussian_filter1d(q, 10, axis=0, mode="nearest")
    dq = np.gradient(q, 0.002, axis=0)
    sensors = plant.Sensors(rate=250.0, torque_noise=0.1)
    motion = q, dq, np.gradient(dq, 0.002, axis=0)
    return plant.measure_along(arm, t, *motion, sensors=sensors, seed=seed)


@pytest.mark.parametrize(
    ("torque", "formula"), [(np.sign, ""), (np.square, "2·dq1² (100 % of its variance)")]
)
def test_a_formula_has_no_term_that_the_model_has_nearly_all_of(torque, formula):
    """In moves between rests 2 % of sgn(q̇) are no Coulomb friction: errors at starts and stops."""
    motion = point_to_point(ROBOT, poses=8, dwell=0.5, speed=0.6, seed=1)
    t = np.arange(0.0, motion.duration, 0.002)
    sensors = plant.Sensors(rate=250.0, torque_noise=0.05)
    recording = plant.measure_along(ARM, t, *motion.at(t), sensors=sensors, seed=1)
    fit = lieid.identify(MODEL, recording)
    rows = Rows.of(fit, process([recording], fit.processing), with_candidates=False)
    speed = np.concatenate([s.values["dq"][s.segment.kept, 0] for s in rows.signals])
    own = torque(speed[rows.runs[0].all])
    with_own = rows.with_apart([own[:, None], np.zeros((rows.runs[1].count, 1))])
    placement = lieid.Model(ROBOT, "smooth/dq:1").placements[0]
    last = np.array([with_own.model[0].shape[1] - 1])
    assert formula_of(with_own, placement, last, np.array([2.0])) == formula
