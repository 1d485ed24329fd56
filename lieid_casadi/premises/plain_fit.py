"""The plain fit that tests premises: rigid body, rotor inertia, Coulomb, viscous friction, offset.

It compares hypotheses about a recording, not effects: a few hundred to a few thousand instants,
and normal equations per joint and per held-out part, from which every error follows.

Two errors are computed. The *free* one is that of a least-squares fit of all link parameters. The
*stated* one takes the masses and inertias of the robot's description: per joint one factor from
0.5 to 2 on their torque, and the joint's own friction and offset. The first needs no masses; the
second also shows what free parameters absorb: a factor, the sign of all torques, the zero of the
last joint.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lieid_casadi.arrays import Array
from lieid_casadi.recording import Processing, Recording, process

Mask = NDArray[np.bool_]
Index = NDArray[np.intp]
#: Held-out parts, and the length of a block of time, s: blocks go to the parts in turn. Errors
#: within a block are correlated, between blocks hardly.
PARTS, BLOCK_SECONDS = 4, 1.5
#: Own columns of a joint: rotor inertia, Coulomb, viscous friction, offset; and friction of the
#: last two joints, which often share a gear, on the sum and difference of their motions.
OWN, FRICTION = 7, [1, 2, 4, 5, 6]
#: Ridge on columns of unit size: directions that the motion does not excite get no weight.
RIDGE = 1e-6
#: Least RMS error that a joint is weighted by, as part of its torque.
LEAST_ERROR = 0.01
#: Range of the filter's cut-off, Hz: rigid motion of an arm, not its vibration.
LOWEST_CUTOFF, HIGHEST_CUTOFF = 1.0, 8.0
#: Cut-off in sample rates, at most.
CUTOFF_OVER_RATE = 0.15
#: Range of the factor on the stated inertias' torque.
LEAST_GAIN, LARGEST_GAIN = 0.5, 2.0
#: A joint that moves less often than this is used at all instants.
SELDOM = 0.1
PER_ROW = ("t", "q", "dq", "ddq", "tau", "moving", "part", "segment", "measured")


@dataclass(frozen=True, eq=False)
class Samples:
    """Low-passed signals of an arm at N instants; arrays (N, n) in SI units.

    ``moving`` is False where a joint rests: its friction is undetermined there. ``part`` (N,) is
    the held-out part of each instant, ``segment`` (N,) the uninterrupted stretch that it belongs
    to, ``measured`` (N, n) the recorded velocity (NaN without), and ``window`` the length of the
    low-pass filter, s.
    """

    t: Array
    q: Array
    dq: Array
    ddq: Array
    tau: Array
    moving: Mask
    part: Index
    segment: Index
    measured: Array
    window: float

    @property
    def n(self) -> int:
        """Number of joints."""
        return int(self.q.shape[1])

    @cached_property
    def used(self) -> Mask:
        """Instants of each joint that are fitted (N, n): in motion, or all if it hardly moves."""
        return np.asarray(self.moving | (np.mean(self.moving, axis=0) < SELDOM))

    @cached_property
    def own(self) -> Array:
        """Own columns (n, OWN, N) of every joint."""
        sign = _low_passed_sign(self.dq, self.ddq, self.window)
        own = np.zeros((self.n, OWN, len(self.t)))
        columns = np.stack([self.ddq, sign, self.dq, np.ones_like(self.dq)])
        own[:, :4] = columns.transpose(2, 0, 1)
        if self.n > 2:
            for k, factor in enumerate((1.0, -1.0), start=4):
                dq, ddq = (x[:, -2] + factor * x[:, -1] for x in (self.dq, self.ddq))
                own[-2:, k] = _low_passed_sign(dq, ddq, self.window)
            own[-2:, 6] = self.dq[:, [-1, -2]].T
        return own

    @cached_property
    def spread(self) -> Array:
        """RMS (n,) of the torques that are fitted about their means, N·m."""
        used = zip(self.tau.T, self.used.T, strict=True)
        return np.maximum([np.std(tau[at]) for tau, at in used], 1e-9)

    @cached_property
    def own_power(self) -> Array:
        """Mean power (n, F) of the joint's own friction columns, relative to that of its torque."""
        used = self.dq.T * self.used.T
        size = np.mean(np.abs(self.tau.T * used), axis=1) + 1e-12
        power = np.einsum("jkt,jt->jk", self.own[:, FRICTION], used) / len(self.t)
        return np.asarray(power / size[:, None])

    @cached_property
    def without_own(self) -> list[tuple[Array, Array, Array]]:
        """Per joint: own columns (OWN, M), what projects on them, the torque without them."""
        made = []
        for j, columns in enumerate(self.own):
            at = self.used[:, j]
            unit = _unit(columns[:, at])
            inverse = np.asarray(np.linalg.solve(unit @ unit.T + RIDGE * np.eye(OWN), unit))
            made.append((unit, inverse, _rest(self.tau[at, j], unit, inverse)))
        return made

    def thinned(self, most: int) -> Samples:
        """Return at most so many instants, evenly spaced."""
        step = -(-len(self.t) // most)
        return self if step <= 1 else self.at(np.arange(step // 2, len(self.t), step))

    def at(self, rows: Index) -> Samples:
        """Return some of the instants."""
        return replace(self, **{field: getattr(self, field)[rows] for field in PER_ROW})


def samples_of(recordings: Sequence[Recording], *, most: int = 2400) -> Samples:
    """Return low-passed signals of recordings with torque.

    Velocities are derivatives of the positions. Of long recordings at most ``most`` instants are
    used, in blocks of time at even distances.
    """
    bare = [replace(r, dq=None, ddq=None, command=None, temperature=None) for r in recordings]
    cutoff = float(np.clip(process(bare)[0].cutoff, LOWEST_CUTOFF, HIGHEST_CUTOFF))
    cutoff = min(cutoff, CUTOFF_OVER_RATE * min(r.rate for r in recordings))
    made, first = list[Samples](), 0
    for recording, without in zip(recordings, bare, strict=True):
        for segment in process(without, Processing(cutoff=cutoff)):
            assert segment.tau is not None
            t = segment.filtered_time
            signals = [
                segment.q,
                segment.dq,
                segment.ddq,
                segment.tau,
                _velocity(recording, segment.t),
            ]
            q, dq, ddq, tau, measured = np.moveaxis(segment.filter(np.stack(signals, 1)), 1, 0)
            block = first + ((t - t[0]) / BLOCK_SECONDS).astype(np.intp)
            first = int(block[-1]) + 1
            stretch = np.full(len(t), len(made))
            moving = segment.filtered_moving
            made.append(
                Samples(t, q, dq, ddq, tau, moving, block, stretch, measured, 0.44 / cutoff)
            )
    fields: dict[str, Any] = {f: np.concatenate([getattr(m, f) for m in made]) for f in PER_ROW}
    joined = replace(made[0], **fields)
    every = -(-len(joined.t) // most)
    if every > 1:
        joined = joined.at(np.flatnonzero(joined.part % every == 0))
        joined = replace(joined, segment=joined.part)
    order = np.unique(joined.part, return_inverse=True)[1]
    return replace(joined, part=order.astype(np.intp) % PARTS)


def _velocity(recording: Recording, t: Array) -> Array:
    """Return the recorded velocity at instants t, NaN without."""
    if recording.dq is None:
        return np.full((len(t), recording.n), np.nan)
    return np.stack([np.interp(t, recording.t, dq) for dq in recording.dq.T], axis=1)


def _low_passed_sign(dq: Array, ddq: Array, window: float) -> Array:
    """Return the sign averaged over the filter's window.

    Around a reversal the velocity changes at a constant rate, so that the average is linear.
    """
    return np.clip(dq / (0.5 * window * np.abs(ddq) + 1e-12), -1.0, 1.0)


@dataclass(frozen=True, eq=False)
class Equations:
    """Normal equations of the free fit, one per joint and part.

    ``matrix`` (n, P, p, p), ``vector`` (n, P, p), ``square`` and ``count`` (n, P): products of the
    columns, of columns and torque, of the torque, and instants.
    """

    matrix: Array
    vector: Array
    square: Array
    count: Array


def equations(columns: Array, s: Samples, *, parts: bool) -> Equations:
    """Return the normal equations of rigid columns (n, k, N) and the joints' own columns."""
    n, k = columns.shape[:2]
    p, count = k + OWN * n, PARTS if parts else 1
    matrix, vector = np.zeros((n, count, p, p)), np.zeros((n, count, p))
    square, rows = np.zeros((n, count)), np.zeros((n, count))
    for j in range(n):
        acting = np.flatnonzero(np.any(columns[j] != 0.0, axis=1))
        index = np.concatenate([acting, np.arange(k + OWN * j, k + OWN * (j + 1))])
        stacked = np.concatenate([columns[j, acting], s.own[j]])
        for part in range(count):
            at = s.used[:, j] & (s.part == part) if parts else s.used[:, j]
            x, y = stacked[:, at], s.tau[at, j]
            matrix[j, part][np.ix_(index, index)] = x @ x.T
            vector[j, part, index] = x @ y
            square[j, part], rows[j, part] = y @ y, len(y)
    return Equations(matrix, vector, square, rows)


@dataclass(frozen=True, eq=False)
class FreeFit:
    """Parameters (p,) and RMS errors per joint (n,), N·m: ``error`` of the fit, ``held_out``.

    ``without`` (P, p) are the parameters of the fits without one part each.
    """

    parameters: Array
    error: Array
    held_out: Array
    without: Array


def free_fit(given: Equations) -> FreeFit:
    """Return the least-squares fit with joints weighted by their own errors."""
    count = np.maximum(given.count.sum(axis=1), 1.0)
    total = np.maximum(given.square.sum(axis=1) / count, 1e-12)
    weights = 1.0 / total
    for _ in range(2):
        a = np.einsum("j,jkab->kab", weights, given.matrix)
        b = np.einsum("j,jka->ka", weights, given.vector)
        fitted = _solved(a.sum(axis=0)[None], b.sum(axis=0)[None])
        error = np.sqrt(_squares(given, np.repeat(fitted, len(a), axis=0)) / count)
        weights = 1.0 / np.maximum(error**2, LEAST_ERROR**2 * total)
    if len(a) == 1:
        return FreeFit(fitted[0], error, error, fitted)
    a = np.einsum("j,jkab->kab", weights, given.matrix)
    b = np.einsum("j,jka->ka", weights, given.vector)
    without = _solved(a.sum(0) - a, b.sum(0) - b)
    return FreeFit(fitted[0], error, np.sqrt(_squares(given, without) / count), without)


def _solved(a: Array, b: Array) -> Array:
    """Return the ridge solutions (m, p) of m systems."""
    size = np.sqrt(np.maximum(np.diagonal(a, axis1=1, axis2=2), 0.0).max(axis=0))
    scale = np.divide(1.0, size, out=np.zeros_like(size), where=size > 1e-9)
    left = a * np.outer(scale, scale)
    left += np.diag(np.where(scale == 0.0, 1.0, RIDGE))
    return np.asarray(np.linalg.solve(left, (b * scale)[..., None])[..., 0] * scale)


def _squares(given: Equations, parameters: Array) -> Array:
    """Return sums of squared errors (n,) for the parameters of each part (P, p)."""
    cross = np.einsum("jka,ka->j", given.vector, parameters)
    product = np.einsum("jkab,kb->jka", given.matrix, parameters)
    quadratic = np.einsum("jka,ka->j", product, parameters)
    return np.asarray(np.maximum(given.square.sum(axis=1) - 2.0 * cross + quadratic, 0.0))


@dataclass(frozen=True, eq=False)
class StatedFit:
    """Fit with stated inertias, per joint (n,).

    ``error`` is with a factor from 0.5 to 2 on their torque, ``own`` without the rigid body, N·m;
    ``gain`` is the factor without bounds (NaN where unknown) and ``share`` the RMS of the stated
    torque that own columns do not explain, N·m.
    """

    error: Array
    own: Array
    gain: Array
    share: Array


def stated_fit(columns: Array, parameters: Array, s: Samples) -> StatedFit:
    """Return the fit with rigid columns (n, 10 n, N) and stated link parameters (10 n,)."""
    torque = parameters @ columns
    result = []
    for j, (unit, inverse, y) in enumerate(s.without_own):
        stated = torque[j, s.used[:, j]]
        x = _rest(stated, unit, inverse)
        size = float(x @ x)
        known = size > 1e-12 * float(stated @ stated) + 1e-18
        gain = float(x @ y) / size if known else np.nan
        rest = y - (min(max(gain, LEAST_GAIN), LARGEST_GAIN) if known else 1.0) * x
        squares = np.array([rest @ rest, y @ y, size]) / max(len(y), 1)
        result.append([*np.sqrt(squares), gain])
    error, alone, share, gains = np.array(result).T
    return StatedFit(error, alone, gains, share)


def _rest(x: Array, unit: Array, inverse: Array) -> Array:
    """Return what rows do not explain of a signal (M,)."""
    return np.asarray(x - (unit @ x) @ inverse)


def _unit(rows: Array) -> Array:
    """Return rows (k, N) of unit size; those without a size as they are."""
    size = np.sqrt(np.einsum("kn,kn->k", rows, rows))[:, None]
    return rows / np.where(size > 0.0, size, 1.0)
