"""Many motions at once: the integrator of `simulate`, compiled, with parameters of each motion."""

from dataclasses import replace

import numpy as np
import pytest
from simulation.test_simulate import ROBOT, fit_of, in_mujoco

import lieid_casadi as lieid
from lieid_casadi.compiled import kernels
from lieid_casadi.errors import ModelError
from lieid_casadi.simulation import simulate_batch

EFFECTS = "coulomb,viscous,armature,load_friction:2"


def inputs_of(count, windows, n=2):
    random = np.random.default_rng(0)
    t = 0.002 * np.arange(count)[:, None, None]
    return 0.3 + 0.5 * np.sin(random.uniform(1.0, 4.0, (windows, n)) * t)


def test_a_batch_has_the_motion_of_the_windows_of_simulate():
    """MuJoCo's recording in windows of 0.5 s, from the states and with the commands of its rows."""
    fit = fit_of("coulomb,viscous,armature")
    recording = in_mujoco(fit, seconds=3.0)
    one = lieid.simulate(fit, recording, window=0.5)
    length = round(0.5 / np.diff(one.t)[0])
    starts = np.arange(0, len(one.t), length)
    rows = np.searchsorted(recording.t, one.t[starts] + 1e-9)[None] + np.arange(length)[:, None] - 1
    q, dq = simulate_batch(
        fit, one.q[starts], one.dq[starts], recording.command[rows], interval=1.0 / recording.rate
    )
    np.testing.assert_allclose(q[:-1].transpose(1, 0, 2).reshape(-1, 2), one.q, atol=2e-4)
    assert q.shape == dq.shape == (length + 1, len(starts), 2)


def test_without_a_compiler_the_motion_is_the_same(monkeypatch):
    fit, inputs = fit_of(EFFECTS), inputs_of(20, 5)
    q = np.full((5, 2), 0.3)
    compiled = simulate_batch(fit, q, 0 * q, inputs, interval=0.002)
    monkeypatch.setattr(kernels.CompilerFailure, "reason", "reported before")
    lieid.simulation.integration._STEPS.clear()
    machine = simulate_batch(fit, q, 0 * q, inputs, interval=0.002)
    lieid.simulation.integration._STEPS.clear()
    np.testing.assert_allclose(compiled, machine, rtol=0, atol=1e-12)


def test_delays_between_two_steps_act_in_proportion():
    """The input of a step is the mean of the commands that act in it: no delay is rounded."""
    fit = fit_of(f"{EFFECTS},command_delay")
    moved = inputs_of(40, 1)
    fits = [
        replace(fit, parameters=np.append(fit.parameters[:-2], [0.001 + late] * 2))
        for late in (0.0042, 0.0045, 0.0048)
    ]
    q = np.full((3, 2), 0.3)
    inputs = np.repeat(moved, 3, axis=1)
    path, _ = simulate_batch(fits, q, 0 * q, inputs, interval=0.002, history=10)
    assert len(path) == 31
    first, middle, last = path[-1]
    assert np.abs(last - first).min() > 1e-6
    np.testing.assert_allclose(middle - first, 0.5 * (last - first), rtol=0.06)


def test_shapes_and_models_that_do_not_fit_are_refused():
    fit, q = fit_of(EFFECTS), np.zeros((3, 2))
    with pytest.raises(ModelError, match=r"expected \(W, 2\)"):
        simulate_batch(fit, q, q, np.zeros((5, 2, 2)), interval=0.01)
    with pytest.raises(ModelError, match="2 fits"):
        simulate_batch([fit, fit], q, q, np.zeros((5, 3, 2)), interval=0.01)
    bare = fit_of("coulomb", replace(ROBOT, joints=lieid.robots.two_link().joints))
    with pytest.raises(ModelError, match="need drives"):
        simulate_batch(bare, q, q, np.zeros((5, 3, 2)), interval=0.01, under="command")
