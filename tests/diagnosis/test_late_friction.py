"""Dry friction that reverses late, as that of a joint that sticks, is not a delayed signal."""

from dataclasses import replace

import numpy as np

import lieid_casadi as lieid
from lieid_casadi import plant
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
    sensors = plant.demo_sensors(ROBOT)
    measured = plant.measure_along(
        arm, T, *motion.at(T), sensors=sensors, seed=seed, name=f"run {seed}"
    )
    return measured, motion


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


def test_nothing_is_stated_where_friction_is_on_time():
    assert not late(lieid.diagnose(MODEL, [recording(seed)[0] for seed in (1, 2)]))
