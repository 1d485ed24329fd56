"""A delay or a filter of the torque signal, in motions with rests between moves."""

from dataclasses import replace

import numpy as np
import pytest
from plant.motions import point_to_point

import lieid_casadi as lieid
from lieid_casadi import plant
from lieid_casadi.effects.torque_delay import where_known

ROBOT = lieid.robots.two_link()
STEP = 0.01  # s


def measured(arm, motion, seed):
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
    fit = lieid.identify(model, measured(arm, before, seed=1))
    late = arm.with_effects(plant.TorqueDelay(1, delay=0.008))
    found = lieid.diagnose(fit, measured(late, after, seed=2))
    assert [(step.effect, step.joints) for step in found.steps] == [("torque_delay", (1,))]
    assert found.steps[0].parameters["delta"] == pytest.approx(0.008, abs=0.2 * STEP)


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
