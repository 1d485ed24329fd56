"""A joint that an object holds against its drive is reported."""

from dataclasses import replace

import numpy as np
import pytest
from drives.commanded import LAWS, TWO_LINK

import lieid_casadi as lieid
from lieid_casadi.diagnosis.events import held_joints

ROBOT = replace(TWO_LINK, gravity=np.zeros(3)).with_drives(LAWS)


def run(held):
    """Return a recording in which joint 2 moves, then rests with a position error, rad."""
    t = np.arange(0.0, 12.0, 0.01)
    inertia = 2.0 * np.cos(2.0 * t) * (t < 9.42)
    q = np.column_stack([np.sin(1.3 * t), np.where(t < 9.42, np.sin(2.0 * t), np.sin(18.84))])
    dq = np.column_stack([1.3 * np.cos(1.3 * t), inertia])
    fit_torque = lieid.compile(ROBOT).inverse_dynamics(
        q, dq, np.gradient(dq, t, axis=0), ROBOT.link_parameters
    )
    friction = [0.4, 0.3] * np.sign(dq)
    stiffness, damping = ([getattr(law, name) for law in LAWS] for name in ("stiffness", "damping"))
    error = (fit_torque + friction + damping * dq) / stiffness
    error[t > 9.6, 1] += held
    noise = 1e-5 * np.random.default_rng(0).normal(size=q.shape)
    return lieid.Recording.from_arrays(t, q + noise, command=q + error).with_drives(LAWS)


@pytest.mark.parametrize("held", [0.0, 0.1])
def test_a_joint_that_is_held(held):
    recording = run(held)
    fit = lieid.identify(lieid.Model(ROBOT, "coulomb,viscous"), recording)
    found = [str(warning) for warning in held_joints(fit, [recording])]
    if not held:
        assert found == []
        return
    (message,) = found
    assert message.startswith("joint 2 rests for ")
    peak = float(message.split("up to ")[1].split()[0])
    assert peak == pytest.approx(LAWS[1].stiffness * held, rel=0.1)


def test_measured_torque_is_not_judged():
    recording = run(0.1)
    fit = lieid.identify(lieid.Model(ROBOT, "coulomb,viscous"), recording)
    assert held_joints(fit, [replace(recording, command=None)]) == []
