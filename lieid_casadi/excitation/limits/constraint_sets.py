"""Limits on a motion at samples: constraint sets behind one interface."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from lieid_casadi.excitation.basis.trajectory import MotionSamples, SampledBasis

Array = NDArray[np.float64]


class ConstraintSet(ABC):
    """Quantities of a motion sample that must stay between limits.

    Attributes
    ----------
    labels : tuple of str
        Name of each quantity in messages.
    units : tuple of str
    lower, upper : (k,)
        Infinite where there is no limit.
    scale : (k,)
        Unit in which violations of different quantities are compared.
    remedy : str
        What to relax, for messages.
    left_out : tuple of str
        Quantities that are not checked.
    """

    labels: tuple[str, ...]
    units: tuple[str, ...]
    lower: Array
    upper: Array
    scale: Array
    remedy: str
    linear: bool = False
    left_out: tuple[str, ...] = ()

    @abstractmethod
    def values(self, motion: MotionSamples) -> Array:
        """Return the quantities (k, N)."""

    @abstractmethod
    def jacobian(self, motion: MotionSamples) -> Array:
        """Return ∂values/∂(q, dq, ddq) (k, 3 n, N), or by the jerk dddq, too (k, 4 n, N)."""

    def excess(self, values: Array) -> Array:
        """Return by how much values (k, N) exceed the limits, in their units; negative inside."""
        return np.maximum(values - self.upper[:, None], self.lower[:, None] - values)


class UncheckedSet(ConstraintSet):
    """A set of a limit none of whose quantities can be checked; without quantities."""

    labels = units = ()
    lower = upper = scale = np.zeros(0)
    remedy = ""

    def __init__(self, left_out: Sequence[str]) -> None:
        self.left_out = tuple(left_out)

    def values(self, motion: MotionSamples) -> Array:
        """See `ConstraintSet`."""
        return np.zeros((0, len(motion)))

    def jacobian(self, motion: MotionSamples) -> Array:
        """See `ConstraintSet`."""
        return np.zeros((0, 3 * motion.q.shape[1], len(motion)))


class JointLimits(ConstraintSet):
    """Position, velocity and acceleration of each joint.

    Parameters
    ----------
    position : (n, 2)
        Lower and upper, rad.
    velocity, acceleration : (n,)
        rad/s, rad/s².
    revolute : (n,), optional
        Whether each joint is revolute; decides the units in messages.
    """

    linear = True
    remedy = "a longer duration, fewer harmonics or wider joint limits"

    def __init__(
        self,
        position: Array,
        velocity: Array,
        acceleration: Array,
        *,
        revolute: NDArray[np.bool_] | None = None,
    ) -> None:
        n = len(velocity)
        turns = np.ones(n, dtype=bool) if revolute is None else revolute
        self.lower = np.concatenate([position[:, 0], -velocity, -acceleration])
        self.upper = np.concatenate([position[:, 1], velocity, acceleration])
        half = 0.5 * (position[:, 1] - position[:, 0])
        self.scale = np.concatenate(
            [np.where(np.isfinite(half), half, np.pi), velocity, acceleration]
        )
        kinds = ("position", "velocity", "acceleration")
        self.labels = tuple(f"{kind} of joint {j + 1}" for kind in kinds for j in range(n))
        self.units = tuple(
            ("rad" if turn else "m") + suffix for suffix in ("", "/s", "/s²") for turn in turns
        )
        self._n = n

    def values(self, motion: MotionSamples) -> Array:
        """See `ConstraintSet`."""
        return np.concatenate([motion.q.T, motion.dq.T, motion.ddq.T])

    def jacobian(self, motion: MotionSamples) -> Array:
        """See `ConstraintSet`."""
        identity = np.eye(3 * self._n)[:, :, None]
        return np.broadcast_to(identity, (3 * self._n, 3 * self._n, len(motion)))


@dataclass(frozen=True, eq=False)
class ConstraintRows:
    """Selected limits at selected samples: set, quantity, sample, side (+1 upper, −1 lower)."""

    sets: NDArray[np.intp]
    quantities: NDArray[np.intp]
    samples: NDArray[np.intp]
    sides: NDArray[np.intp]

    def __len__(self) -> int:
        return len(self.sets)

    @cached_property
    def keys(self) -> set[tuple[int, int, int, int]]:
        """The rows as tuples."""
        columns = (self.sets, self.quantities, self.samples, self.sides)
        return set(zip(*(column.tolist() for column in columns), strict=True))

    def without(self, other: ConstraintRows) -> ConstraintRows:
        """Return the rows that are not among the other's."""
        keys = zip(*(column.tolist() for column in self.columns), strict=True)
        return self.chosen(np.array([key not in other.keys for key in keys], dtype=bool))

    def joined(self, other: ConstraintRows) -> ConstraintRows:
        """Return these rows and the other's that are not among them."""
        new = other.without(self)
        pairs = zip(self.columns, new.columns, strict=True)
        return ConstraintRows(*(np.concatenate(pair) for pair in pairs))

    @property
    def columns(self) -> tuple[NDArray[np.intp], ...]:
        """The four arrays."""
        return self.sets, self.quantities, self.samples, self.sides

    def chosen(self, mask: NDArray[np.bool_]) -> ConstraintRows:
        """Return some of the rows."""
        return ConstraintRows(*(column[mask] for column in self.columns))


class SampledConstraints:
    """Constraint sets on a grid of times, as scaled excesses of the free variables z.

    The excess is the distance beyond a limit in parts of its scale, plus ``margin``: a motion with
    nonpositive excess keeps the margin from every limit.

    Parameters
    ----------
    sets : tuple of ConstraintSet
    sampled : SampledBasis
        Grid of times.
    margin : float
    """

    def __init__(
        self, sets: tuple[ConstraintSet, ...], sampled: SampledBasis, *, margin: float
    ) -> None:
        self.sets = sets
        self.sampled = sampled
        self.margin = margin

    def excess(self, motion: MotionSamples) -> list[tuple[Array, Array]]:
        """Return per set the scaled excesses (k, N) above the upper and below the lower limits."""
        result = []
        for limits in self.sets:
            values, scale = limits.values(motion), limits.scale[:, None]
            result.append(
                (
                    (values - limits.upper[:, None]) / scale + self.margin,
                    (limits.lower[:, None] - values) / scale + self.margin,
                )
            )
        return result

    def largest(self, excess: list[tuple[Array, Array]]) -> float:
        """Return the largest scaled excess."""
        return max(float(side.max()) for pair in excess for side in pair)

    def peaks(self, excess: list[tuple[Array, Array]], threshold: float) -> ConstraintRows:
        """Return the local maxima over time of excesses above a threshold."""
        found: list[tuple[NDArray[np.intp], ...]] = []
        for index, pair in enumerate(excess):
            for side, values in zip((1, -1), pair, strict=True):
                before, after = np.roll(values, 1, axis=1), np.roll(values, -1, axis=1)
                quantity, sample = np.nonzero(
                    (values > threshold) & (values >= before) & (values > after)
                )
                found.append(
                    (np.full_like(quantity, index), quantity, sample, np.full_like(quantity, side))
                )
        return ConstraintRows(*(np.concatenate(column) for column in zip(*found, strict=True)))

    def at(self, excess: list[tuple[Array, Array]], rows: ConstraintRows) -> Array:
        """Return the excesses of rows (R,)."""
        result = np.empty(len(rows))
        for index, (upper, lower) in enumerate(excess):
            own = rows.sets == index
            where = rows.quantities[own], rows.samples[own]
            result[own] = np.where(rows.sides[own] > 0, upper[where], lower[where])
        return result

    def jacobian(self, motion: MotionSamples, rows: ConstraintRows) -> Array:
        """Return ∂excess/∂z (R, n d) of rows."""
        functions = self.sampled.functions  # (n, 4, N, d)
        n, _, _, d = functions.shape
        result = np.zeros((len(rows), n, d))
        for index, limits in enumerate(self.sets):
            own = np.flatnonzero(rows.sets == index)
            if not len(own):
                continue
            samples, place = np.unique(rows.samples[own], return_inverse=True)
            slopes = limits.jacobian(motion.at(samples))
            kinds = slopes.shape[1] // n  # of derivatives of the position, itself included
            slopes = slopes[rows.quantities[own], :, place]  # (R, kinds n)
            factor = rows.sides[own] / limits.scale[rows.quantities[own]]
            slopes = (slopes * factor[:, None]).reshape(-1, kinds, n)
            result[own] = np.einsum(
                "rkj,jkrd->rjd", slopes, functions[:, :kinds, rows.samples[own], :], optimize=True
            )
        return result.reshape(len(rows), n * d)
