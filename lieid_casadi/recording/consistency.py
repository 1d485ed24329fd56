"""Signals of a recording compared with each other: torque and motion, on block means."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import linear_sum_assignment

from lieid_casadi.arrays import Array, Mask
from lieid_casadi.errors import (
    ConstantTorqueWarning,
    LieidWarning,
    TorqueClippedWarning,
    TorqueOrderWarning,
    TorqueSignWarning,
)
from lieid_casadi.messages import joints_text
from lieid_casadi.recording.recording import Recording
from lieid_casadi.robot.robot import Robot

#: Length of a block, s: short against the motion of an arm, long against sensor noise.
BLOCK_SECONDS = 0.04


@dataclass(frozen=True, eq=False)
class Blocks:
    """Means over B blocks; ``dq`` and ``ddq`` are differences of q, not the measured dq."""

    q: Array  # (B, n)
    dq: Array
    ddq: Array
    tau: Array | None  # (B, n)
    nominal: Array | None
    travelled: Array  # (B', n) change of q from one block's first row to the next one's
    integrated: Array | None  # the same of the integral of the measured dq


def block_means(recording: Recording, nominal: Array | None = None) -> Blocks:
    """Return block means of all segments; no block spans a gap."""
    size = max(1, round(BLOCK_SECONDS * recording.rate))
    edges = _edges(recording, size)
    parts: dict[str, list[Array]] = {name: [] for name in Blocks.__dataclass_fields__}
    for first, last in edges:
        rows = slice(first, last)
        t, q = recording.t[rows], recording.q[rows]
        measured = None if recording.dq is None else recording.dq[rows]
        time = _means(t[:, None], size)[:, 0]
        parts["q"].append(_means(q, size))
        parts["dq"].append(np.gradient(parts["q"][-1], time, axis=0))
        parts["ddq"].append(np.gradient(parts["dq"][-1], time, axis=0))
        parts["travelled"].append(np.diff(q[::size], axis=0))
        if measured is not None:
            steps = 0.5 * (measured[1:] + measured[:-1]) * np.diff(t)[:, None]
            way = np.vstack([np.zeros((1, q.shape[1])), np.cumsum(steps, axis=0)])
            parts["integrated"].append(np.diff(way[::size], axis=0))
        if recording.tau is not None:
            parts["tau"].append(_means(recording.tau[rows], size))
        if nominal is not None:
            parts["nominal"].append(_means(nominal[rows], size))
    empty = np.empty((0, recording.n))
    joined = {name: np.concatenate(rows) if rows else None for name, rows in parts.items()}
    for name in ("q", "dq", "ddq", "travelled"):
        joined[name] = empty if joined[name] is None else joined[name]
    return Blocks(**joined)  # type: ignore[arg-type]


def _edges(recording: Recording, size: int) -> list[tuple[int, int]]:
    """Return first and last row of the segments that hold at least three blocks."""
    lengths = [len(segment) for segment in recording.segments()]
    ends = np.cumsum(lengths)
    return [
        (int(end - length), int(end))
        for length, end in zip(lengths, ends, strict=True)
        if length >= 3 * size
    ]


def _means(x: Array, size: int) -> Array:
    count = x.shape[0] // size
    return np.asarray(x[: count * size].reshape(count, size, x.shape[1]).mean(axis=1))


#: Correlation with the nominal torque beyond which the sign of the torque is determined.
DECISIVE = 0.5
#: Least decrease of the sum over the joints of the log of unexplained variance by which another
#: order of the joints is reported. On recordings of real arms every exchange of two joints loses
#: 2 or more with a nominal model; without one, indistinguishable exchanges gain 0.02.
ORDER_GAIN = 1.0
#: Least ratio of the nominal torque to the measured one, friction removed, to determine a sign.
EXPECTED_PART = 0.3
#: Ratio of torque to the robot's limit from which the unit is in doubt, not the limit.
FAR_BEYOND = 3.0
#: Least ratio of a friction coefficient to its standard deviation to determine its sign.
SIGNIFICANT = 5.0
#: Least part of a friction column (mean square) that the other columns do not explain. Of the
#: velocity it is 0.009 to 0.2 on recordings of real arms, below 1e-4 on one period of a Fourier
#: motion.
LEAST_OWN = 0.005
#: Beyond this, errors of the columns that stand for the rigid body are nearly independent, s.
CORRELATED_SECONDS = 1.0
#: Least motion, rad or m, from which friction can be estimated.
ENOUGH_MOTION = 0.05


def check_torque(recording: Recording, blocks: Blocks, robot: Robot | None) -> list[LieidWarning]:
    """Report torques that are constant, exchanged, of the wrong sign or clipped."""
    if recording.tau is None:
        return []
    title = recording.title
    found = [*_constant(recording, title), *_clipped(recording, title, robot)]
    moving = np.ptp(blocks.q, axis=0) > ENOUGH_MOTION if len(blocks.q) else np.zeros(0, bool)
    columns = 7 * int(moving.sum())
    if blocks.tau is None or len(blocks.q) < 4 * columns or not moving.any():
        return found
    exchanged = _exchanged(blocks, moving)
    if exchanged:
        pairs = ", ".join(f"tau{j + 1} fits joint {k + 1}" for j, k in exchanged.items())
        return [
            *found,
            TorqueOrderWarning(
                f"{title}: torques of joints seem to be exchanged ({pairs}): check the "
                "order of the columns"
            ),
        ]
    return found + _swapped(blocks, moving, title)


def _constant(recording: Recording, title: str) -> list[LieidWarning]:
    """Name joints whose torque has one value only."""
    assert recording.tau is not None
    constant = np.ptp(recording.tau, axis=0) == 0.0
    if not constant.any():
        return []
    values = ", ".join(f"{value:g}" for value in np.unique(recording.tau[0, constant])[:4])
    return [
        ConstantTorqueWarning(
            f"{title}: torque of {joints_text(constant)} is {values} N·m in every row: was it "
            "recorded? The parameters of these joints are not identifiable from it"
        )
    ]


def _exchanged(blocks: Blocks, moving: Mask) -> dict[int, int]:
    """Return column of tau -> joint that explains it better, if another order is clearly better."""
    joints = np.nonzero(moving)[0]
    misfit = np.zeros((joints.size, joints.size))
    assert blocks.tau is not None
    for b, k in enumerate(joints):
        columns = np.column_stack([_gravity_like(blocks, int(k), moving), _own(blocks, int(k))])
        tau = blocks.tau[:, joints]
        rest = tau - columns @ np.linalg.lstsq(columns, tau, rcond=None)[0]
        unexplained = np.sum(rest**2, axis=0) / np.maximum(
            np.sum((tau - tau.mean(axis=0)) ** 2, axis=0), 1e-300
        )
        misfit[:, b] = np.log(np.clip(unexplained, 1e-12, 1.0))
    rows, best = linear_sum_assignment(misfit)
    gain = float(np.trace(misfit) - misfit[rows, best].sum())
    if gain < ORDER_GAIN:
        return {}
    return {int(joints[a]): int(joints[b]) for a, b in zip(rows, best, strict=True) if a != b}


def _gravity_like(blocks: Blocks, joint: int, moving: Mask) -> Array:
    """Return the columns of the rigid body: nominal torque, or sines and cosines of all joints."""
    if blocks.nominal is not None:
        return np.column_stack([np.ones(len(blocks.q)), blocks.nominal[:, joint]])
    return _angles(blocks.q[:, moving])


def _angles(q: Array) -> Array:
    """Return 1, sines and cosines of all joints, and of sums and differences of neighbours."""
    angles = np.column_stack([q, q[:, 1:] + q[:, :-1], q[:, 1:] - q[:, :-1]])
    return np.column_stack([np.ones(len(q)), np.sin(angles), np.cos(angles)])


def _own(blocks: Blocks, joint: int) -> Array:
    """Return the columns of the joint's own motion: inertia and friction."""
    dq = blocks.dq[:, joint]
    return np.column_stack([blocks.ddq[:, joint], np.sign(dq), dq])


def _swapped(blocks: Blocks, moving: Mask, title: str) -> list[LieidWarning]:
    friction = _driving_friction(blocks, moving)
    if blocks.nominal is None:
        against = np.zeros_like(moving)
    else:
        correlation = _model_correlation(blocks)
        against = correlation < -DECISIVE
        friction &= correlation < DECISIVE
    found: list[LieidWarning] = []
    if against.any():
        found.append(
            TorqueSignWarning(
                f"{title}: torque of {joints_text(against)} is opposite to the nominal model "
                f"(correlation {correlation[against].min():.2f}): check the sign of the torque"
            )
        )
    friction &= ~against
    if friction.any():
        found.append(
            TorqueSignWarning(
                f"{title}: friction of {joints_text(friction)} would drive the joint: check the "
                "signs of torque and velocity"
            )
        )
    return found


def _model_correlation(blocks: Blocks) -> Array:
    """Return the correlation (n,) of measured and nominal torque, friction removed from both."""
    assert blocks.tau is not None
    assert blocks.nominal is not None
    correlation = np.zeros(blocks.tau.shape[1])
    for j in range(correlation.size):
        dq = blocks.dq[:, j]
        friction = np.column_stack([np.ones_like(dq), np.sign(dq), dq])
        both = np.column_stack([blocks.tau[:, j], blocks.nominal[:, j]])
        rest = both - friction @ np.linalg.lstsq(friction, both, rcond=None)[0]
        norms = np.linalg.norm(rest, axis=0)
        # a nominal torque of rounding noise, or small beside the measured one, decides nothing
        rounding = 1e-6 * np.linalg.norm(blocks.nominal)
        if norms[1] > max(rounding, EXPECTED_PART * norms[0]):
            correlation[j] = rest[:, 0] @ rest[:, 1] / max(norms[0] * norms[1], 1e-300)
    return correlation


def _driving_friction(blocks: Blocks, moving: Mask) -> Mask:
    """Return the joints whose fitted friction clearly adds power, which friction cannot do.

    Each torque is fitted by gravity-like and inertia-like columns of all joints and by the
    joint's own friction. Coulomb friction decides where it is significant: its jump at a reversal
    is like no other column. Where it is not, viscous friction decides, unless the velocity is
    almost a sum of the other columns: errors of these columns then give it any sign.
    """
    assert blocks.tau is not None
    q, ddq = blocks.q[:, moving], blocks.ddq[:, moving]
    common = np.column_stack([_angles(q), ddq])
    driving = np.zeros(moving.size, dtype=bool)
    for j in np.nonzero(moving)[0]:
        tau = blocks.tau[:, j]
        friction = np.column_stack([np.sign(blocks.dq[:, j]), blocks.dq[:, j]])
        sizes = np.mean(friction**2, axis=0)
        values, std, own, error = _friction(np.column_stack([common, friction]), tau)
        decides = 0 if abs(values[0]) > SIGNIFICANT * std[0] else 1
        strong = values**2 * sizes > max(error, 1e-4 * np.mean(tau**2))
        clear = strong & (own > LEAST_OWN * sizes) & (values < -SIGNIFICANT * std)
        driving[j] = clear[decides]
    return driving


def _friction(columns: Array, tau: Array) -> tuple[Array, Array, Array, float]:
    """Fit the columns, of which the last two are friction.

    The residual is correlated in time, since the columns are no complete model of the arm. The
    standard deviations follow from its sums over intervals of `CORRELATED_SECONDS`, between which
    it counts as independent (batch means).

    Returns
    -------
    tuple
        Of the last two columns: coefficients, standard deviations, and mean squares of the part
        that the other columns do not explain. Mean square of the residual.
    """
    weights = np.linalg.pinv(columns, rcond=1e-12)
    solution = weights @ tau
    residual = tau - columns @ solution
    weights = weights[-2:]
    starts = np.arange(0, len(tau), round(CORRELATED_SECONDS / BLOCK_SECONDS))
    sums = np.add.reduceat(weights * residual, starts, axis=1)
    lost = len(tau) / (len(tau) - columns.shape[1])  # rows to parameters
    own = 1.0 / (len(tau) * np.maximum(np.sum(weights**2, axis=1), 1e-300))
    std = np.sqrt(lost * np.sum(sums**2, axis=1))
    return solution[-2:], std, own, float(np.mean(residual**2))


def _clipped(recording: Recording, title: str, robot: Robot | None) -> list[LieidWarning]:
    assert recording.tau is not None
    magnitude = np.abs(recording.tau)
    clipped = np.array([_stuck_at_top(column) for column in magnitude.T])
    clipped &= _in_motion(recording, magnitude)
    at_limit, excess = np.zeros(recording.n, dtype=bool), 0.0
    if robot is not None:
        limits = np.array([joint.limits.torque for joint in robot.joints])
        with np.errstate(invalid="ignore", divide="ignore"):
            at_limit = np.sum(magnitude >= 0.999 * limits, axis=0) >= 3
            excess = float(np.max((magnitude / limits)[:, at_limit], initial=0.0))
    found: list[LieidWarning] = []
    if (clipped & ~at_limit).any():
        mask = clipped & ~at_limit
        level = float(magnitude[:, mask].max(axis=0)[0])
        found.append(
            TorqueClippedWarning(
                f"{title}: torque of {joints_text(mask)} stays at its largest value "
                f"({level:.4g}): it seems to be clipped"
            )
        )
    if at_limit.any():
        found.append(
            TorqueClippedWarning(
                f"{title}: torque of {joints_text(at_limit)} reaches the robot's torque limit"
                + (
                    f", up to {excess:.3g} times: expected SI units (N·m)"
                    if excess > FAR_BEYOND
                    else ""
                )
            )
        )
    return found


def _stuck_at_top(magnitude: Array) -> bool:
    """Return whether many values are at the top and few just below it.

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
    """Return whether joints move where their torque is largest; holding still is no clipping."""
    dq = recording.dq
    if dq is None:
        dq = np.gradient(recording.q, recording.t, axis=0)
    top = magnitude >= 0.999 * magnitude.max(axis=0)
    speed = np.array([np.median(np.abs(v[at])) for v, at in zip(dq.T, top.T, strict=True)])
    return np.asarray(speed > 0.01 * np.abs(dq).max(axis=0))
