"""Constant-speed runs: the paper's speeds, the same way back, within limits."""

import numpy as np
import pytest

import lieid_casadi as lieid
from lieid_casadi.errors import ExcitationError, NoSolution
from lieid_casadi.excitation import Torque, friction_sweep

PANDA = lieid.Model(lieid.robots.panda())


@pytest.fixture(scope="module")
def sweep():
    return friction_sweep(PANDA, 2, seconds=2.0, limits=[Torque()])


def test_speeds_of_the_paper_forward_and_backward(sweep):
    forward = np.rad2deg([p.speed for p in sweep.parts[::2]])
    back = np.rad2deg([p.speed for p in sweep.parts[1::2]])
    assert len(forward) == 28
    assert np.isclose(forward[0], 0.1)
    assert np.isclose(forward[-1], 30.0)
    np.testing.assert_allclose(back, -forward)
    assert sweep.left_out == ()


def test_speed_is_constant_and_positions_are_the_same_both_ways(sweep):
    t, q, dq = sweep.motion.t, sweep.motion.q[:, 2], sweep.motion.dq[:, 2]
    for forward, back in zip(sweep.parts[::2], sweep.parts[1::2], strict=True):
        ranges = []
        for part in (forward, back):
            inside = (t >= part.start + 1e-9) & (t <= part.end - 1e-9)
            assert inside.sum() > 3
            np.testing.assert_allclose(dq[inside], part.speed, rtol=1e-9)
            ranges.append(np.sort(np.interp([part.start, part.end], t, q)))
        np.testing.assert_allclose(ranges[0], ranges[1], atol=2e-3 * abs(forward.speed))


def test_speeds_beyond_the_limits_are_left_out():
    fast = friction_sweep(PANDA, 0, speeds=[0.1, 3.0], seconds=1.0, limits=[])
    assert fast.left_out == (3.0,)
    assert len(fast.parts) == 2


@pytest.mark.parametrize("joint", [0, 1])
def test_default_limits_hold_where_the_middle_of_the_range_is_horizontal(joint):
    """A pose is found around which the joint can move above the floor; height by hand."""
    sweep = friction_sweep(lieid.Model(lieid.robots.two_link()), joint, speeds=[0.1, 0.5])
    q = sweep.motion.q
    elbow = 0.5 * np.sin(q[:, 0])
    tool = elbow + 0.4 * np.sin(q.sum(axis=1))
    assert min(elbow.min(), tool.min()) > 0.0
    assert len(sweep.parts) == 4
    assert "floor" not in sweep.unchecked


def test_files(sweep):
    import json

    table, text = (data.decode() for data in sweep.files().values())
    lines = table.splitlines()
    assert "# not checked: self-collision" in lines
    rows = np.loadtxt([line for line in lines if line[0] != "#"][1:], delimiter=",")
    np.testing.assert_allclose(rows[:, 3], sweep.motion.q[:, 2], atol=1e-10)
    content = json.loads(text)
    assert content["joint"] == 3
    assert len(content["parts"]) == 56


def test_bad_requests():
    with pytest.raises(ExcitationError, match="no joint 9; the arm has 1 to 7"):
        friction_sweep(PANDA, 8)
    with pytest.raises(NoSolution, match="too short for every speed"):
        friction_sweep(PANDA, 0, speeds=[5.0], limits=[])
    with pytest.raises(NoSolution, match="torque of joint"):
        friction_sweep(PANDA, 1, speeds=[0.1], limits=[Torque(0.01, dry=0.0, viscous=0.0)])
