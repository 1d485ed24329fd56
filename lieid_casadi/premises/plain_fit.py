"""The plain fit that tests premises: rigid body, rotor inertia, Coulomb, viscous friction, offset.

It compares hypotheses about a recording, not effects: a few hundred to a few thousand instants,
and normal equations per joint and per held-out part, from which every error follows. The own
columns of each joint are eliminated, so that only base parameters are solved for.

Two errors are computed. The *free* one is that of a least-squares fit of all link parameters. The
*stated* one takes the masses and inertias of the robot's description: per joint one factor from
0.5 to 2 on their torque, and the joint's own friction and offset. The first needs no masses; the
second also shows what parameters absorb: a factor, the sign of all torques, the last joint's zero.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from lieid_casadi.arrays import Array, Indices, Mask
from lieid_casadi.recording import Processing, Recording, choose_cutoff, process
from lieid_casadi.recording.sample_timing import require_plausible_rate

#: Held-out parts, and the length of a block of time, s: blocks go to the parts in turn. Errors
#: within a block are correlated, between blocks hardly. Short recordings have shorter blocks, so
#: that each part has two.
PARTS, BLOCK_SECONDS, SHORTEST_BLOCK = 4, 1.5, 0.25
#: Own columns of a joint: rotor inertia, Coulomb, viscous friction, offset; and friction of the
#: last two joints, which often share a gear, on the sum and difference of their motions.
OWN, VISCOUS, FRICTION = 7, 2, [1, 2, 4, 5, 6]
#: Ridge on columns of unit size: directions that the motion does not excite get no weight.
RIDGE = 1e-6
#: Least RMS error that a joint is weighted by, as part of its torque.
LEAST_ERROR = 0.01
#: Range of the filter's cut-off, Hz: rigid motion of an arm, not its vibration.
LOWEST_CUTOFF, HIGHEST_CUTOFF = 1.0, 8.0
#: Cut-off in sample rates, at most, and the time from which it is chosen, s.
CUTOFF_OVER_RATE, CUTOFF_SECONDS = 0.15, 20.0
MOST_INSTANTS = 2400  # of the samples
#: Range of the factor on the stated inertias' torque.
LEAST_GAIN, LARGEST_GAIN = 0.5, 2.0
#: A joint that moves less often than this is used at all instants.
SELDOM = 0.1
PER_ROW = ("t", "q", "dq", "ddq", "tau", "moving", "part", "segment", "measured")


@dataclass(frozen=True, eq=False)
class Samples:
    """Low-passed signals of an arm at N instants; arrays (N, n) in SI units."""

    t: Array  # (N,)
    q: Array
    dq: Array
    ddq: Array
    tau: Array
    moving: Mask  # False where a joint rests: its friction is undetermined there
    part: Indices  # (N,) held-out part
    segment: Indices  # (N,) uninterrupted stretch
    measured: Array  # recorded velocity, NaN without
    window: float  # length of the low-pass filter, s

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

    def at(self, rows: Indices) -> Samples:
        """Return some of the instants."""
        return replace(self, **{field: getattr(self, field)[rows] for field in PER_ROW})


def samples_of(recordings: Sequence[Recording]) -> Samples:
    """Return low-passed signals of recordings: derived velocities, instants in blocks."""
    bare = [replace(r, dq=None, ddq=None, command=None, temperature=None) for r in recordings]
    for recording in bare:
        require_plausible_rate(recording.t, recording.title)
    longest = [max(r.segments(), key=lambda segment: segment.duration) for r in bare]
    chosen = np.median([choose_cutoff(r.at(r.t <= r.t[0] + CUTOFF_SECONDS)) for r in longest])
    cutoff = float(np.clip(chosen, LOWEST_CUTOFF, HIGHEST_CUTOFF))
    cutoff = min(cutoff, CUTOFF_OVER_RATE * min(r.rate for r in recordings))
    segments = [
        (recording, segment)
        for recording, without in zip(recordings, bare, strict=True)
        for segment in process(without, Processing(cutoff=cutoff))
    ]
    duration = sum(float(np.ptp(segment.filtered_time)) for _, segment in segments)
    seconds = np.clip(duration / (2 * PARTS), SHORTEST_BLOCK, BLOCK_SECONDS)
    made, first = list[Samples](), 0
    for recording, segment in segments:
        assert segment.tau is not None
        t, velocity = segment.filtered_time, _velocity(recording, segment.t)
        signals = [segment.q, segment.dq, segment.ddq, segment.tau, velocity]
        q, dq, ddq, tau, measured = np.moveaxis(segment.filter(np.stack(signals, 1)), 1, 0)
        block = first + ((t - t[0]) / seconds).astype(np.intp)
        first = int(block[-1]) + 1
        stretch = np.full(len(t), len(made))
        moving = segment.filtered_moving
        made.append(Samples(t, q, dq, ddq, tau, moving, block, stretch, measured, 0.44 / cutoff))
    fields: dict[str, Any] = {f: np.concatenate([getattr(m, f) for m in made]) for f in PER_ROW}
    joined = replace(made[0], **fields)
    every = -(-len(joined.t) // MOST_INSTANTS)
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
    """Return the sign averaged over the filter's window, in which dq is taken as linear."""
    return np.clip(dq / (0.5 * window * np.abs(ddq) + 1e-12), -1.0, 1.0)


@dataclass(frozen=True, eq=False)
class Design:
    """Columns of the free fit, and their products per joint and held-out part."""

    columns: Array  # (n, p, N) of the base parameters and the joint's own
    used: Mask  # (n, P, N) instants of each part that are fitted
    matrix: Array  # (n, P, p, p) products of the columns

    def equations(self, tau: Array) -> Equations:
        """Return the normal equations for torques (N, n)."""
        fitted = tau.T[:, None] * self.used
        vector = fitted @ self.columns.swapaxes(1, 2)
        square = np.sum(fitted**2, axis=2)
        return Equations(self.matrix, vector, square, self.used.sum(axis=2))


def design(columns: Array, s: Samples, *, parts: bool) -> Design:
    """Return the design of rigid columns (n, k, N) and the joints' own."""
    every = np.concatenate([columns, s.own], axis=1)
    used = s.used.T[:, None]
    if parts:
        used = used & (s.part == np.arange(PARTS)[:, None])
    fitted = every[:, None] * used[:, :, None]
    return Design(every, used, fitted @ fitted.swapaxes(2, 3))


@dataclass(frozen=True, eq=False)
class Equations:
    """Normal equations of the free fit, one per joint and part."""

    matrix: Array  # (n, P, p, p) products of the columns
    vector: Array  # (n, P, p) products of columns and torque
    square: Array  # (n, P) product of the torque
    count: Array  # (n, P) instants

    @cached_property
    def products(self) -> tuple[Array, Array]:
        """Matrices (n, p, p) and vectors (n, p) of all parts together."""
        return self.matrix.sum(axis=1), self.vector.sum(axis=1)

    @cached_property
    def whole(self) -> _Eliminated:
        """All parts together (n, …)."""
        return _Eliminated.of(*self.products)

    @cached_property
    def instants(self) -> Array:
        """Number of instants (n,) of each joint, at least one."""
        return np.asarray(np.maximum(self.count.sum(axis=1), 1.0))

    def own_power(self, s: Samples) -> Array:
        """Return the power (n, F) of the own friction columns, relative to that of the torque."""
        size = np.mean(np.abs(s.tau * s.dq * s.used), axis=0) + 1e-12
        k = self.matrix.shape[-1] - OWN
        products = self.products[0][:, k + np.array(FRICTION), k + VISCOUS]
        return np.asarray(products / (size * len(s.t))[:, None])


@dataclass(frozen=True, eq=False)
class _Eliminated:
    """Normal equations (n, …) without the joints' own columns; those are start − lift·β."""

    matrix: Array
    vector: Array
    size: Array  # squares of the columns before the elimination
    lift: Array
    start: Array

    @classmethod
    def of(cls, matrix: Array, vector: Array) -> _Eliminated:
        """Eliminate the last columns of matrices (n, …, p, p)."""
        k = matrix.shape[-1] - OWN
        own, both = matrix[..., k:, k:], matrix[..., k:, :k]
        scale = _inverse_size(np.diagonal(own, axis1=-2, axis2=-1))
        outer = scale[..., :, None] * scale[..., None, :]
        unit = own * outer
        inverse = np.linalg.inv(unit + RIDGE * np.eye(OWN))
        # the products of exact residuals of a fit with a ridge, not the ridge's minimum
        inverse = inverse @ (2.0 * np.eye(OWN) - unit @ inverse) * outer
        lift = inverse @ both
        start = np.einsum("...ab,...b->...a", inverse, vector[..., k:])
        return cls(
            matrix[..., :k, :k] - np.swapaxes(both, -1, -2) @ lift,
            vector[..., :k] - np.einsum("...ba,...b->...a", both, start),
            np.diagonal(matrix, axis1=-2, axis2=-1)[..., :k],
            lift,
            start,
        )

    def solved(self, weights: Array) -> Array:
        """Return base and own parameters (n, …, p) of the fit with weights (n,) of the joints."""
        a, b, size = (
            (weights @ x.reshape(len(x), -1)).reshape(x.shape[1:])
            for x in (self.matrix, self.vector, self.size)
        )
        scale = _inverse_size(size)
        left = a * scale[..., :, None] * scale[..., None, :]
        index = np.arange(scale.shape[-1])
        left[..., index, index] += np.where(scale == 0.0, 1.0, RIDGE)
        base = np.linalg.solve(left, (b * scale)[..., None])[..., 0] * scale
        own = self.start - np.einsum("j...ak,...k->j...a", self.lift, base)
        return np.concatenate([np.broadcast_to(base, (len(own), *base.shape)), own], axis=-1)


def _inverse_size(squares: Array) -> Array:
    """Return one over the size of columns; 0 for those without a size."""
    size = np.sqrt(np.maximum(squares, 0.0))
    return np.divide(1.0, size, out=np.zeros_like(size), where=size > 1e-9)


@dataclass(frozen=True, eq=False)
class FreeFit:
    """Least-squares fit of all base parameters; RMS errors (n,), N·m."""

    base: Array  # (k,)
    own: Array  # (n, OWN) parameters of the joints
    error: Array
    held_out: Array
    own_without: Array  # (P, n, OWN) of the fits without one part each


def free_fit(given: Equations) -> FreeFit:
    """Return the least-squares fit with joints weighted by their own errors."""
    total = np.maximum(given.square.sum(axis=1) / given.instants, 1e-12)
    weights = 1.0 / total
    for _ in range(2):
        fitted = given.whole.solved(weights)
        error = _error(given, fitted[:, None])
        weights = 1.0 / np.maximum(error**2, LEAST_ERROR**2 * total)
    k = fitted.shape[1] - OWN
    if given.matrix.shape[1] == 1:
        return FreeFit(fitted[0, :k], fitted[:, k:], error, error, fitted[None, :, k:])
    matrix, vector = given.matrix, given.vector
    others = _Eliminated.of(
        matrix.sum(axis=1, keepdims=True) - matrix, vector.sum(axis=1, keepdims=True) - vector
    )
    without = others.solved(weights)
    own_without = without[..., k:].transpose(1, 0, 2)
    return FreeFit(fitted[0, :k], fitted[:, k:], error, _error(given, without), own_without)


def _error(given: Equations, parameters: Array) -> Array:
    """Return RMS errors (n,) for parameters (n, P or 1, p) of each part."""
    every = np.broadcast_to(parameters, given.vector.shape)
    product = np.einsum("jkab,jkb->jka", given.matrix, every)
    squares = given.square + np.sum((product - 2.0 * given.vector) * parameters, axis=2)
    return np.asarray(np.sqrt(np.maximum(squares.sum(axis=1), 0.0) / given.instants))


@dataclass(frozen=True, eq=False)
class StatedFit:
    """Fit with stated inertias, per joint (n,); errors in N·m."""

    error: Array  # with a factor from 0.5 to 2 on their torque
    own: Array  # without the rigid body
    gain: Array  # the factor without bounds, NaN where unknown
    share: Array  # RMS of the stated torque that own columns do not explain, N·m


def stated_fit(given: Equations, parameters: Array) -> StatedFit:
    """Return the fit with stated base parameters (k,)."""
    k = len(parameters)
    matrix, vector = given.products
    alone = given.square.sum(axis=1) - np.sum(vector[:, k:] * given.whole.start, axis=1)
    size = parameters @ given.whole.matrix @ parameters
    known = size > 1e-10 * (parameters @ matrix[:, :k, :k] @ parameters) + 1e-18
    along = given.whole.vector @ parameters
    gain = np.divide(along, size, out=np.full(len(size), np.nan), where=known)
    bounded = np.where(known, np.clip(gain, LEAST_GAIN, LARGEST_GAIN), 1.0)
    left = alone - bounded * (2.0 * along - bounded * size)
    error, own, share = np.sqrt(np.maximum([left, alone, size], 0.0) / given.instants)
    return StatedFit(error, own, gain, share)
