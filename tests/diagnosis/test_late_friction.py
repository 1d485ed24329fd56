"""Delays, dry friction that reverses late, and what is not the same in all training recordings."""

from dataclasses import replace

import numpy as np
import pytest
from hidden_effects.motions import point_to_point
from plant.recordings import recorded

import lieid_casadi as lieid
from lieid_casadi import plant
from lieid_casadi.effects.torque_delay import where_known
from lieid_casadi.errors import LateFrictionWarning

ROBOT = lieid.robots.two_link()
MODEL = lieid.Model(ROBOT, "coulomb,viscous,offset")
COULOMB = np.array([1.5, 3.0])  # N·m
T = np.arange(0.0, 20.0, 0.005)


def recording(seed):
    """Return a recording without hidden effects, and its motion."""
    arm = plant.demo_arm(ROBOT, hidden=None)
    arm = replace(arm, friction=replace(arm.friction, coulomb=COULOMB))
    motion = plant.FourierTrajectory(ROBOT, base_frequency=0.1, seed=seed)
    sensors, name = plant.demo_sensors(ROBOT), f"run {seed}"
    return plant.measure_along(arm, T, *motion.at(T), sensors=sensors, seed=seed, name=name), motion


def with_late_friction(seed, delay):
    measured, motion = recording(seed)
    sign, late = (np.sign(motion.at(t)[1][:, 1]) for t in (T, T - delay))
    tau = measured.tau.copy()
    tau[:, 1] += COULOMB[1] * (late - sign)
    return replace(measured, tau=tau)


def with_late_torque(seed, delay, joint):
    measured, _ = recording(seed)
    tau = measured.tau.copy()
    tau[:, joint] = np.interp(T - delay, T, tau[:, joint])
    return replace(measured, tau=tau)


def late(diagnosis):
    return [str(w) for w in diagnosis.warnings if isinstance(w, LateFrictionWarning)]


def test_friction_that_reverses_late_is_stated_and_not_named_as_a_delay():
    diagnosis = lieid.diagnose(MODEL, [with_late_friction(seed, 0.008) for seed in (1, 2)])
    assert not diagnosis.steps
    (text,) = late(diagnosis)
    assert "joint 2 (8" in text
    assert "joint 1" not in text


def test_a_delay_of_all_torque_is_named():
    diagnosis = lieid.diagnose(MODEL, [with_late_torque(seed, 0.008, 0) for seed in (1, 2)])
    (step,) = diagnosis.steps
    assert "torque_delay:1" in {step.label, *(rival.label for rival in step.rivals)}
    assert not late(diagnosis)


def test_a_shift_of_time_takes_the_place_of_a_filter():
    """The errors of all joints decide: that of joint 1 alone is lower with the filter."""
    arm = plant.demo_arm(ROBOT, hidden=None).with_effects(plant.TimeShift(0.05))
    (step,) = lieid.diagnose(MODEL, recorded(arm, 3, seconds=12.0)).steps
    assert step.label == "time_shift"
    assert "torque_lowpass/common_second_order" in {rival.label for rival in step.rivals}


def test_nothing_is_stated_where_friction_is_on_time():
    assert not late(lieid.diagnose(MODEL, [recording(seed)[0] for seed in (1, 2)]))


STEP = 0.01  # s


def sampled(arm, motion, seed):
    t = np.arange(0.0, motion.duration, STEP / 10)
    sensors = plant.Sensors(
        rate=1.0 / STEP, counts_per_turn=2.0**18, velocity="none", torque_noise=(0.02, 0.02)
    )
    return plant.measure_along(arm, t, *motion.at(t), sensors=sensors, seed=seed)


def test_a_delay_is_estimated_from_the_moves():
    """The instants at which joints start and stop have an error of up to one sample."""
    arm = plant.demo_arm(ROBOT, hidden=None)
    arm = replace(arm, friction=replace(arm.friction, coulomb=4.0 * arm.friction.coulomb))
    before = plant.FourierTrajectory(ROBOT, base_frequency=1 / 15, seed=1)
    after = point_to_point(ROBOT, poses=6, seed=4)
    model = lieid.Model(ROBOT, "coulomb,viscous,offset")
    fit = lieid.identify(model, sampled(arm, before, seed=1))
    late = arm.with_effects(plant.TorqueDelay(1, delay=0.008))
    found = lieid.diagnose(fit, sampled(late, after, seed=2))
    assert [(step.effect, step.joints) for step in found.steps] == [("torque_delay", (1,))]
    assert found.steps[0].parameters["delta"] == pytest.approx(0.008, abs=0.2 * STEP)


def test_a_delay_is_fitted_to_moves_between_rests():
    """Late torque after a rest contains friction of the rest, which is not known."""
    arm = plant.demo_arm(ROBOT, hidden=None)
    arm = replace(arm, friction=replace(arm.friction, coulomb=4.0 * arm.friction.coulomb))
    late = arm.with_effects(plant.TorqueDelay(1, delay=0.02))
    model = lieid.Model(ROBOT, "coulomb,viscous,offset,torque_delay:2")
    moves = [sampled(late, point_to_point(ROBOT, poses=6, seed=s), seed=s) for s in (3, 4)]
    delay = lieid.identify(model, moves).effect_coefficients[-1]
    assert delay == pytest.approx(0.02, abs=0.1 * STEP)


@pytest.mark.parametrize(
    ("past", "zero"), [(0.0, range(29, 41)), (0.05, range(29, 46)), (-0.05, range(24, 41))]
)
def test_a_change_is_zero_as_long_as_it_depends_on_a_rest(past, zero):
    t = STEP * np.arange(100)
    moving = np.ones((100, 2), dtype=bool)
    moving[30:40, 0] = False  # joint 2 never rests
    change = where_known(np.ones((100, 2)), t, moving, past + 1e-9 * np.sign(past))
    assert set(np.flatnonzero(change[:, 0] == 0.0)) == set(zero)
    assert np.all(change[:, 1] == 1.0)


RATES = {"first": (0.16, -0.1), "second": (-0.24, 0.1), "third": (0.48, 0.02)}  # N·m/s
MORE = {"coulomb": 1.0, "viscous": 1.0, "offset": 1.0}  # N·m, N·m·s/rad, N·m


def with_more(seed, name, more=None):
    """Return a recording of an arm whose joint 1 has more friction of one kind."""
    arm = plant.demo_arm(ROBOT, hidden=None)
    if more is not None:
        value = getattr(arm.friction, more) + np.array([MORE[more], 0.0])
        arm = replace(arm, friction=replace(arm.friction, **{more: value}))
    return recorded(arm, seed, step=0.004, name=name)


@pytest.mark.parametrize("effect", MORE)
def test_friction_that_is_larger_in_one_recording_is_stated(effect):
    train = [with_more(1, "first"), with_more(2, "second", effect), with_more(3, "third")]
    diagnosis = lieid.diagnose(MODEL, train)
    assert not diagnosis.steps
    (found,) = diagnosis.differing
    assert (found.label, found.recording, found.of_model) == (f"{effect}:1", "second", True)
    (value,) = found.parameters.values()
    assert value == pytest.approx(MORE[effect], rel=0.1)
    assert f"in second, {effect} on joint 1 (" in diagnosis.sentence


def test_an_effect_in_one_recording_is_no_rival_of_an_effect_of_the_arm():
    arm = plant.demo_arm(ROBOT, hidden=None)
    arm = arm.with_effects(plant.hidden_effect(arm, "stribeck", 0, strength=0.3))
    t, train = np.arange(0.0, 16.0, 0.002), []
    for seed, speed in ((1, 1.0), (2, 0.4)):  # nearly constant: other friction in one fits as well
        rate = np.array([1.5, 2.1])
        phase = rate * t[:, None] + seed
        dq = speed * np.tanh(6.0 * np.sin(phase))
        ddq = speed * 6.0 * rate * np.cos(phase) / np.cosh(6.0 * np.sin(phase)) ** 2
        motion = (np.cumsum(dq, axis=0) * 0.002, dq, ddq)
        sensors = plant.demo_sensors(ROBOT)
        train.append(plant.measure_along(arm, t, *motion, sensors=sensors, seed=seed))
    (step,) = lieid.diagnose(MODEL, train).steps
    assert step.label == "stribeck:1"
    assert not any("recording" in rival.label for rival in step.rivals)


def test_an_effect_that_one_recording_cannot_show_is_an_effect_of_the_arm():
    arm = plant.demo_arm(ROBOT, hidden=None)
    arm = arm.with_effects(plant.hidden_effect(arm, "viscous_polynomial", 0, strength=2.0))
    t, train = np.arange(0.0, 10.0, 0.004), []
    for seed, scale in ((1, 0.1), (2, 1.0)):
        motion = plant.FourierTrajectory(ROBOT, base_frequency=0.1, seed=seed).at(t)
        sensors = plant.demo_sensors(ROBOT)
        slower = [scale * x for x in motion]
        train.append(plant.measure_along(arm, t, *slower, sensors=sensors, seed=seed))
    diagnosis = lieid.diagnose(MODEL, train)
    assert [step.label for step in diagnosis.steps] == ["viscous_polynomial:1"]
    assert not diagnosis.differing


def test_a_drift_is_explained_in_its_recording_and_not_expected_in_the_test():
    arm = plant.demo_arm(ROBOT, hidden=None).with_effects(plant.BiasDrift(0, rate=0.8))
    train, test = (recorded(arm, seed, step=0.004, name=f"{seed}.csv") for seed in (1, 2))
    diagnosis = lieid.diagnose(MODEL, train)
    assert [step.label for step in diagnosis.steps] == ["bias_drift:1"]
    assert diagnosis.verdict == "effect_found"
    np.testing.assert_allclose(lieid.compare(diagnosis.fit, train).rms, diagnosis.fit.rms_train)
    (part,) = (tested := lieid.diagnose(MODEL, train, test)).unexplained
    assert (part.joint, part.recordings, part.differs) == (0, "test", True)
    assert tested.steps[0].confirmed is None


@pytest.mark.parametrize("rate", [0.0, 0.4])
def test_a_drift_of_the_fit_is_not_expected_in_new_recordings(rate):
    """Neither a comparison nor a diagnosis of changes takes its absence for a change."""
    arm = plant.demo_arm(ROBOT, hidden=None)
    base = recorded(arm.with_effects(plant.BiasDrift(0, rate=0.8)), 1, step=0.004, name="base")
    fit = lieid.identify(MODEL.with_effect("bias_drift/2:1"), base)
    new = recorded(arm.with_effects(plant.BiasDrift(0, rate=rate)), 2, step=0.004, name="new")
    diagnosis = lieid.diagnose(fit, new)
    found = {step.label: step.parameters["r"] for step in diagnosis.steps}
    assert found == ({"bias_drift:1": pytest.approx(rate, abs=0.02)} if rate else {})
    np.testing.assert_allclose(diagnosis.fit.values, fit.values)
    assert not any("does not model" in sentence for sentence in diagnosis.sentences)


def test_the_drift_of_a_recording_in_which_a_joint_rests_is_unknown():
    t = np.arange(0.0, 15.0, 0.004)
    arm, train = plant.demo_arm(ROBOT, hidden=None), []
    for seed, rate in ((1, 0.5), (2, -0.3)):
        q, dq, ddq = plant.FourierTrajectory(ROBOT, base_frequency=0.1, seed=seed).at(t)
        if seed == 2:
            q[:, 1], dq[:, 1], ddq[:, 1] = 0.3, 0.0, 0.0
        drifting = arm.with_effects(*(plant.BiasDrift(j, rate=rate) for j in (0, 1)))
        sensors = plant.demo_sensors(ROBOT)
        train.append(plant.measure_along(drifting, t, q, dq, ddq, sensors=sensors, seed=seed))
    steps = {step.label: step for step in lieid.diagnose(MODEL, train).steps}
    assert steps.keys() == {"bias_drift/2:1", "bias_drift/2:2"}
    assert steps["bias_drift/2:1"].parameters["r2"] == pytest.approx(-0.3, abs=0.02)
    assert steps["bias_drift/2:2"].parameters["r1"] == pytest.approx(0.5, abs=0.02)
    assert steps["bias_drift/2:2"].std["r2"] > 1.0


def test_drifts_of_each_recording_are_in_the_model_beside_the_effect_of_the_arm():
    arm, train = plant.demo_arm(ROBOT, hidden=None), []
    arm = arm.with_effects(plant.hidden_effect(arm, "load_friction", 0, strength=1.0))
    for seed, (name, rates) in enumerate(RATES.items(), start=1):
        drifts = [plant.BiasDrift(joint, rate=rate) for joint, rate in enumerate(rates)]
        train.append(recorded(arm.with_effects(*drifts), seed, step=0.004, name=name))
    diagnosis = lieid.diagnose(MODEL, train)
    found = {step.label: list(step.parameters.values()) for step in diagnosis.steps}
    assert found.pop("load_friction:1")
    assert diagnosis.verdict == "effect_found"
    assert not diagnosis.differing
    for joint, rates in enumerate(zip(*RATES.values(), strict=True)):
        assert found.pop(f"bias_drift/3:{joint + 1}") == pytest.approx(rates, abs=0.05)
    assert not found
