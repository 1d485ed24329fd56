"""Designs end to end. `test_random_arms` verifies the limits of designs independently."""

import numpy as np
import pinocchio as pin
import pytest

import lieid_casadi as lieid
from lieid_casadi.excitation import Torque, excite
from lieid_casadi.robot.pinocchio_model import build_pinocchio

PANDA = lieid.robots.panda()


def test_condition_number_and_torque_match_pinocchio():
    """σ₁/σ_r of Pinocchio's own regressor, at the samples; its torque at 1 kHz."""
    found = excite(
        lieid.Model(PANDA), criterion="condition", limits=[Torque(0.9, dry=0.0, viscous=0.0)],
        acceleration=5.0, starts=1, max_iterations=60,
    )  # fmt: skip
    assert found.quality.rank == 43
    assert found.max_violation == 0.0
    model = build_pinocchio(PANDA)
    data = model.createData()
    motion = found.trajectory.at(0.2 * np.arange(100))
    stacked = np.vstack(
        [
            pin.computeJointTorqueRegressor(model, data, *signals)
            for signals in zip(motion.q, motion.dq, motion.ddq, strict=True)
        ]
    )
    sizes = np.linalg.svd(stacked, compute_uv=False)
    assert np.isclose(found.condition_number, sizes[0] / sizes[42], rtol=1e-8)
    assert sizes[43] < 1e-8 * sizes[0]
    base = stacked[:, found.model.base.kept]
    assert np.isclose(found.neg_log_det, -np.linalg.slogdet(base.T @ base)[1])
    motion = found.motion(1000.0)
    torques = [
        pin.rnea(model, data, *x).copy() for x in zip(motion.q, motion.dq, motion.ddq, strict=True)
    ]
    assert np.all(np.abs(torques) <= 0.9 * PANDA.limit("torque"))


def test_the_file_begins_and_ends_at_rest_at_the_rest_pose():
    """Position, velocity and acceleration are continuous."""
    found = excite(
        lieid.Model(lieid.robots.two_link()), duration=6.0, starts=1, rate=500.0,
        start_pose=[0.3, -0.4], limits=(), max_iterations=20,
    )  # fmt: skip
    motion = found.motion()
    np.testing.assert_allclose(motion.q[[0, -1]], [[0.3, -0.4]] * 2, atol=1e-9)
    np.testing.assert_allclose(motion.dq[[0, -1]], 0.0, atol=1e-9)
    np.testing.assert_allclose(motion.ddq[[0, -1]], 0.0, atol=1e-7)
    assert motion.t[-1] == pytest.approx(found.duration)
    for low, high in ((motion.q, motion.dq), (motion.dq, motion.ddq)):
        trapezoid = 0.5 * (high[1:] + high[:-1]) / 500.0
        np.testing.assert_allclose(np.diff(low, axis=0), trapezoid, atol=2e-4)
