"""Span of the columns of rigid body and plain friction, by Pinocchio's regressor.

It is independent of the package's dynamics and effects. Columns are evaluated along the noiseless
motion as the encoders measure it, so that the torque of an arm without hidden effects lies in
their span.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lieid_casadi.plant import Arm, EncoderOffset, Sensors, TrueMotion, build_pinocchio, measure
from lieid_casadi.plant.sensors import sampled_rows

Array = NDArray[np.float64]
SLOWEST = 1e-3  # rad/s, m/s: below it dry friction is undetermined
SINGULAR = 1e-9  # of the largest singular value


@dataclass(frozen=True, eq=False)
class NoiselessRecord:
    """Recording of ideal sensors at a reduced rate: (K, n) arrays, t is (K,)."""

    t: Array
    q: Array
    dq: Array
    ddq: Array
    tau: Array
    load: Array
    moving: NDArray[np.bool_]


def noiseless_record(arm: Arm, motion: TrueMotion, rate: float) -> NoiselessRecord:
    """Return an arm's noiseless recording of a motion at a rate (Hz), with the acceleration."""
    t, rows = motion.t, sampled_rows(motion.t, rate)
    ideal = measure(arm, motion, Sensors(rate=rate))
    q = motion.motor_q.copy()
    for effect in arm.effects_of(EncoderOffset):
        q[:, effect.joint] -= effect.offset
    assert ideal.tau is not None
    moving = ~motion.resting & (np.abs(motion.motor_dq) > SLOWEST)
    return NoiselessRecord(
        t[rows], q[rows], motion.motor_dq[rows], motion.motor_ddq[rows],
        ideal.tau, motion.rigid[rows], moving[rows],
    )  # fmt: skip


def columns(robot, record: NoiselessRecord) -> Array:
    """Return rigid, Coulomb, viscous and offset columns (K, n, 10 n + 3 n)."""
    import pinocchio as pin

    model = build_pinocchio(robot)
    data, n = model.createData(), robot.n
    whole = np.zeros((len(record.t), n, 13 * n))
    for k in range(len(record.t)):
        whole[k, :, : 10 * n] = pin.computeJointTorqueRegressor(
            model, data, record.q[k], record.dq[k], record.ddq[k]
        )
    joints = np.arange(n)
    whole[:, joints, 10 * n + joints] = np.sign(record.dq)
    whole[:, joints, 11 * n + joints] = record.dq
    whole[:, joints, 12 * n + joints] = 1.0
    return whole


def whitened(values: Array, seen: NDArray[np.bool_], t: Array, white: Array, time: float) -> Array:
    """Return the innovations (K, n, m) of a Kalman filter for white and first-order noise.

    Both together have unit variance; ``white`` (n,) is the part of white noise, ``time`` the
    correlation time (s) of the rest. Rows (K, n) that are not ``seen`` give zero.
    """
    state, shown = np.zeros(values.shape[1:]), np.zeros(values.shape)
    variance = 1.0 - white
    keep = np.exp(-np.diff(t, prepend=t[0]) / time)
    for k in range(len(t)):
        state = keep[k] * state
        variance = keep[k] ** 2 * variance + (1.0 - keep[k] ** 2) * (1.0 - white)
        whole = variance + np.maximum(white, 1e-6)
        error = np.where(seen[k][:, None], values[k] - state, 0.0)
        shown[k] = error / np.sqrt(whole)[:, None]
        gain = np.where(seen[k], variance / whole, 0.0)
        state = state + gain[:, None] * error
        variance = variance * (1.0 - gain)
    return shown


class BaseSpan:
    """Span of the columns of the base model; rows of each joint are divided by its noise."""

    def __init__(self, robot, record: NoiselessRecord, noise: Array) -> None:
        self.record, self.noise = record, noise
        weighted = self.stacked(columns(robot, record))
        scale = np.linalg.norm(weighted, axis=0)
        q, r = np.linalg.qr(weighted / np.where(scale > 0.0, scale, 1.0))
        u, s, _ = np.linalg.svd(r)
        self.basis = q @ u[:, s > SINGULAR * s[0]]

    def stacked(self, values: Array) -> Array:
        """Return values (K, n, …) in motion, divided by the noise, joint after joint (R, …)."""
        parts = [
            values[self.record.moving[:, j], j] / self.noise[j]
            for j in range(self.record.q.shape[1])
        ]
        return np.concatenate(parts)

    def outside(self, stacked: Array, further: Array | None = None) -> Array:
        """Return the part of (R, …) that base columns and further columns (R, m) do not span."""
        rest = stacked - self.basis @ (self.basis.T @ stacked)
        rest = rest - self.basis @ (self.basis.T @ rest)
        if further is None or not further.size:
            return rest
        others = self.outside(further)
        q, r = np.linalg.qr(others)
        q = q[:, np.abs(np.diag(r)) > 1e-9 * max(np.abs(np.diag(r)).max(), 1e-12)]
        return rest - q @ (q.T @ rest)

    def unstacked(self, stacked: Array) -> Array:
        """Return the values (K, n) of stacked rows (R,); zero where a joint rests."""
        values = np.zeros(self.record.q.shape)
        parts = np.split(stacked, np.cumsum(self.record.moving.sum(axis=0))[:-1])
        for j, part in enumerate(parts):
            values[self.record.moving[:, j], j] = part * self.noise[j]
        return values

    def by_joint(self, stacked: Array) -> Array:
        """Return the RMS (n,) of stacked rows per joint, in multiples of the noise."""
        counts = self.record.moving.sum(axis=0)
        parts = np.split(stacked, np.cumsum(counts)[:-1])
        return np.array([np.sqrt(np.mean(p * p)) if len(p) else 0.0 for p in parts])
