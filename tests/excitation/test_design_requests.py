"""Designs that are refused, infeasible or interrupted."""

import numpy as np
import pytest

import lieid_casadi as lieid
from lieid_casadi.errors import ExcitationError, NoSolution
from lieid_casadi.excitation import CartesianSpeed, Torque, Wall, excite, floor

PANDA = lieid.robots.panda()


def test_a_start_pose_in_collision_is_refused_before_the_search():
    under_the_floor = [0.0, 1.7, 0.0, -0.2, 0.0, 1.8, 0.0]
    with pytest.raises(NoSolution, match=r"start pose violates a limit at rest: .* from the floor"):
        excite(lieid.Model(PANDA), start_pose=under_the_floor, limits=[floor(0.15)])


def test_interrupt_before_anything_is_feasible():
    """`test_excite_command` interrupts a design that has a feasible motion."""

    def progress(stage, fraction):
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        excite(lieid.Model(lieid.robots.two_link()), starts=1, progress=progress, limits=())


def test_infeasible_workspace_names_the_limit():
    ceiling = Wall((0.0, 0.0, 1.0), 0.45, "ceiling")
    with pytest.raises(NoSolution, match=r"no start pose .* from the ceiling is violated"):
        excite(lieid.Model(PANDA), limits=[ceiling], starts=1, max_iterations=20)


def test_torque_limit_below_gravity_is_infeasible():
    limits = [Torque(0.01, dry=0.0, viscous=0.0)]
    with pytest.raises(NoSolution, match="torque of joint"):
        excite(lieid.Model(lieid.robots.two_link()), limits=limits, start_pose=[0.0, 0.5])


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
        ({}, {"starts": 0}, "starts: 0; expected 1"),
        ({}, {"max_iterations": 0}, "max_iterations: 0; expected 1"),
        ({}, {"seed": -1}, "seed: -1; expected 0"),
        ({}, {"rate": 0.0}, "rate: 0 Hz"),
        ({}, {"rate": 1e12}, "rate: 1e\\+12 Hz gives 2e\\+13 rows .* at most 10000000"),
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
