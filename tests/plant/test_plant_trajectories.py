"""Trajectories keep to the limits, start and end at rest, and are smooth."""

import numpy as np
import pytest
from plant.motions import point_to_point
from robot.random_arms import random_arm

from lieid_casadi import robots
from lieid_casadi.errors import RobotError
from lieid_casadi.plant import FourierTrajectory

ARMS = [robots.panda, robots.two_link, lambda: random_arm(np.random.default_rng(1), 5)]


def _fourier(robot):
    return FourierTrajectory(robot, harmonics=6, base_frequency=0.2, periods=2, seed=4)


def _moves(robot):
    return point_to_point(robot, poses=5, dwell=0.4, seed=4)


@pytest.mark.parametrize("robot", [make() for make in ARMS], ids=lambda r: r.name)
@pytest.mark.parametrize("make", [_fourier, _moves])
def test_motion_is_feasible_smooth_and_rests_at_both_ends(robot, make):
    path = make(robot)
    t = np.linspace(-0.5, path.duration + 0.5, 40001)
    q, dq, ddq = path.at(t)
    assert np.all(q >= robot.limit("position_lower") - 1e-9)
    assert np.all(q <= robot.limit("position_upper") + 1e-9)
    assert np.all(np.abs(dq) <= robot.limit("velocity"))
    acceleration = np.minimum(robot.limit("acceleration"), 5.0)
    assert np.all(np.abs(ddq) <= acceleration + 1e-9)
    assert np.abs(dq).max() > 0.2 * np.max(robot.limit("velocity")[1:2])
    outside = (t <= 0) | (t >= path.duration)
    assert not dq[outside].any()
    assert not ddq[outside].any()
    step = t[1] - t[0]
    np.testing.assert_allclose(np.gradient(q, step, axis=0), dq, atol=5 * step)
    np.testing.assert_allclose(np.gradient(dq, step, axis=0), ddq, atol=400 * step)


def test_fourier_trajectories_are_periodic_and_reproducible():
    robot = robots.panda()
    t = np.linspace(0.1, 4.9, 100)
    one = _fourier(robot)
    np.testing.assert_allclose(one.at(t)[0], one.at(t + 5.0)[0], atol=1e-12)
    np.testing.assert_array_equal(one.at(t)[0], _fourier(robot).at(t)[0])
    other = FourierTrajectory(robot, harmonics=6, base_frequency=0.2, seed=5)
    assert np.abs(one.at(t)[0] - other.at(t)[0]).max() > 0.1


def test_a_series_of_one_harmonic_is_refused():
    with pytest.raises(RobotError, match="expected at least 2"):
        FourierTrajectory(robots.two_link(), harmonics=1, seed=0)
