"""Masses of a feasible fit against those that the robot states, and the gravity load it saw."""

from dataclasses import replace

import numpy as np
import pytest

import lieid_casadi as lieid
from lieid_casadi import plant
from lieid_casadi.errors import StatedMassWarning

ROBOT = lieid.robots.two_link()


@pytest.fixture(scope="module")
def run():
    t = np.arange(0.0, 10.0, 0.01)
    motion = plant.FourierTrajectory(ROBOT, base_frequency=0.1, seed=1).at(t)
    sensors = replace(plant.demo_sensors(ROBOT), rate=100.0)
    arm = plant.demo_arm(ROBOT, hidden=None)
    return plant.measure_along(arm, t, *motion, sensors=sensors, seed=1, name="run")


@pytest.mark.parametrize(("factor", "far"), [(1.0, False), (8.0, True)])
def test_masses_far_from_the_stated_ones_are_a_warning(run, factor, far):
    scaled = replace(run, tau=factor * run.tau)
    fit = lieid.identify(lieid.Model(ROBOT), scaled, method="feasible", regularization=1e-4)
    found = [w for w in fit.warnings if isinstance(w, StatedMassWarning)]
    assert len(found) == far
    assert not far or "3 kg by the description" in str(found[0])
    stated = ROBOT.link_parameters
    g = 9.81 * stated[11] * np.cos(run.q.sum(axis=1))  # of link 2 on joint 2, about its axis
    load = np.sqrt(np.mean(g**2))
    np.testing.assert_allclose(fit.certificate.stated_gravity[1], load, rtol=0.05)
    np.testing.assert_allclose(fit.certificate.gravity[1], factor * load, rtol=0.3)
    assert "Gravity load that the recordings showed" in fit.certificate.summary()
