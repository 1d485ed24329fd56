"""Torque: sign, order of the joints, clipping."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from scipy.optimize import linear_sum_assignment

from lieid_casadi.errors import (
    LieidWarning,
    TorqueClippedWarning,
    TorqueOrderWarning,
    TorqueSignWarning,
)
from lieid_casadi.recording.arrays import Array, Mask
from lieid_casadi.recording.blocks import Blocks
from lieid_casadi.recording.recording import Recording
from lieid_casadi.recording.wording import joints_text

if TYPE_CHECKING:
    from lieid_casadi.robot.robot import Robot

#: Correlation with the nominal torque below which a sign counts as swapped.
SWAPPED = -0.5
#: What another order of the joints must gain in correlation, per exchanged joint.
ORDER_GAIN = 0.3


def check_torque(
    recording: Recording, blocks: Blocks, robot: Robot | None
) -> list[LieidWarning]:
    """Clipped, swapped or exchanged torques."""
    if recording.tau is None:
        return []
    title = recording.name or "recording"
    found = _clipped(recording, title, robot)
    if blocks.tau is None or blocks.tau.shape[0] < 20:
        return found
    if blocks.nominal is not None:
        return found + _against_model(blocks, title)
    return found + _against_friction(blocks, title)


def _against_model(blocks: Blocks, title: str) -> list[LieidWarning]:
    """Correlation of every measured torque with every nominal one, friction taken out."""
    correlation = _model_correlation(blocks)
    rows, columns = linear_sum_assignment(-np.abs(correlation))
    own = np.diag(correlation)
    gained = np.abs(correlation[rows, columns]) - np.abs(own)
    exchanged = (columns != rows) & (np.abs(correlation[rows, columns]) > 0.7)
    found: list[LieidWarning] = []
    if exchanged.sum() >= 2 and gained[exchanged].mean() > ORDER_GAIN:
        pairs = ", ".join(f"tau{j + 1} runs like joint {columns[j] + 1}" for j in rows[exchanged])
        found.append(
            TorqueOrderWarning(f"{title}: torques exchanged? Against the nominal model, {pairs}")
        )
    else:
        exchanged[:] = False
    swapped = ~exchanged & (own < SWAPPED)
    if swapped.any():
        found.append(
            TorqueSignWarning(
                f"{title}: torque of {joints_text(swapped)} runs against the nominal model "
                f"(correlation {own[swapped].min():.2f}): sign swapped?"
            )
        )
    return found


def _model_correlation(blocks: Blocks) -> Array:
    assert blocks.tau is not None and blocks.nominal is not None
    n = blocks.tau.shape[1]
    correlation = np.zeros((n, n))
    for j in range(n):
        dq = blocks.dq[:, j]
        friction = np.column_stack([np.ones_like(dq), np.sign(dq), dq])
        rest = np.column_stack([blocks.tau[:, [j]], blocks.nominal])
        rest = rest - friction @ np.linalg.lstsq(friction, rest, rcond=None)[0]
        norms = np.linalg.norm(rest, axis=0)
        scale = norms[0] * np.maximum(norms[1:], 1e-3 * norms.max(initial=1e-300))
        correlation[j] = rest[:, 0] @ rest[:, 1:] / np.maximum(scale, 1e-300)
    return correlation


def _against_friction(blocks: Blocks, title: str) -> list[LieidWarning]:
    """Without a model: friction takes power from the drive, it never gives any.

    Each torque is fitted by gravity-like and inertia-like columns of all joints and by the
    joint's own friction; friction that drives the joint, clearly, means a swapped sign.
    """
    assert blocks.tau is not None
    moving = np.ptp(blocks.q, axis=0) > 0.05
    q, ddq = blocks.q[:, moving], blocks.ddq[:, moving]
    common = np.column_stack([np.ones(len(q)), np.sin(q), np.cos(q), ddq])
    if common.shape[0] < 4 * common.shape[1]:
        return []
    swapped = np.zeros(moving.size, dtype=bool)
    for j in np.nonzero(moving)[0]:
        dq, tau = blocks.dq[:, j], blocks.tau[:, j]
        columns = np.column_stack([common, np.sign(dq), dq])
        solution = np.linalg.lstsq(columns, tau, rcond=None)[0]
        friction = columns[:, -2:] @ solution[-2:]
        residual = tau - columns @ solution
        strong = np.sqrt(np.mean(friction**2)) > np.sqrt(np.mean(residual**2))
        power = friction @ dq / (np.linalg.norm(friction) * np.linalg.norm(dq) + 1e-300)
        swapped[j] = bool(strong and power < -0.7)
    if not swapped.any():
        return []
    return [
        TorqueSignWarning(
            f"{title}: friction of {joints_text(swapped)} would drive the joint: sign of the "
            "torque or of the velocity swapped?"
        )
    ]


def _clipped(recording: Recording, title: str, robot: Robot | None) -> list[LieidWarning]:
    assert recording.tau is not None
    magnitude = np.abs(recording.tau)
    clipped = np.array([_stuck_at_top(column) for column in magnitude.T])
    clipped &= _in_motion(recording, magnitude)
    at_limit = np.zeros(recording.n, dtype=bool)
    if robot is not None:
        limits = np.array([joint.limits.torque for joint in robot.joints])
        with np.errstate(invalid="ignore"):
            at_limit = np.sum(magnitude >= 0.999 * limits, axis=0) >= 3
    found: list[LieidWarning] = []
    if (clipped & ~at_limit).any():
        mask = clipped & ~at_limit
        level = float(magnitude[:, mask].max(axis=0)[0])
        found.append(
            TorqueClippedWarning(
                f"{title}: torque of {joints_text(mask)} is stuck at its largest value "
                f"({level:.4g}): clipped?"
            )
        )
    if at_limit.any():
        found.append(
            TorqueClippedWarning(
                f"{title}: torque of {joints_text(at_limit)} reaches the robot's torque limit"
            )
        )
    return found


def _stuck_at_top(magnitude: Array) -> bool:
    """Many values at the top and few just below it.

    A smooth peak has 2.4 times as many samples in its top slice as in the next one of the
    same width; a clipped one has far more.
    """
    top = float(magnitude.max())
    if top == 0.0:
        return False
    distinct = np.unique(magnitude)
    quantum = float(np.min(np.diff(distinct))) if distinct.size > 1 else top
    width = max(1e-3 * top, 0.75 * quantum)
    at_top = int(np.sum(magnitude > top - width))
    below = int(np.sum((magnitude > top - 2.0 * width) & (magnitude <= top - width)))
    return at_top >= max(10, 0.003 * magnitude.size) and at_top > 6 * below


def _in_motion(recording: Recording, magnitude: Array) -> Mask:
    """Whether the joints move where their torque is largest: a steady hold is no clipping."""
    dq = recording.dq
    if dq is None:
        dq = np.gradient(recording.q, recording.t, axis=0)
    top = magnitude >= 0.999 * magnitude.max(axis=0)
    speed = np.array([np.mean(np.abs(v[at])) for v, at in zip(dq.T, top.T, strict=True)])
    return np.asarray(speed > 0.01 * np.abs(dq).max(axis=0))
