"""Ranges of shape parameters, and the scale on which they are searched."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from lieid_casadi.arrays import Array
from lieid_casadi.effects.effect import DataRange
from lieid_casadi.model import Model
from lieid_casadi.recording import Processed

AT_BOUND = 1e-3  # of the range: a shape nearer to its end counts as at the bound
TAIL = 0.5  # percent of the samples beyond either end of the range of a signal


class Bounded(Protocol):
    """A quantity with finite bounds, such as a `Shape` or a `Parameter`."""

    @property
    def lower(self) -> float:
        """Lower bound."""

    @property
    def upper(self) -> float:
        """Upper bound."""


@dataclass(frozen=True, eq=False)
class ShapeRange:
    """Bounds (s,) of shape parameters, searched by their place in the range, 0 to 1.

    The place is logarithmic where the lower bound is above zero, linear elsewhere.
    """

    lower: Array
    upper: Array

    @classmethod
    def of(cls, parameters: Sequence[Bounded]) -> ShapeRange:
        """Return the ranges of parameters."""
        return cls(
            np.array([p.lower for p in parameters], dtype=float),
            np.array([p.upper for p in parameters], dtype=float),
        )

    def place(self, shapes: Array) -> Array:
        """Return the places (…, s) of shapes in their ranges."""
        with np.errstate(divide="ignore", invalid="ignore"):
            ratio = np.log(shapes / self.lower) / self._decades
        linear = (shapes - self.lower) / (self.upper - self.lower)
        return np.where(self._logarithmic, ratio, linear)

    def shapes(self, place: Array) -> Array:
        """Return the shapes (…, s) at places in their ranges."""
        start = np.where(self._logarithmic, self.lower, 1.0)
        logarithmic = start * np.exp(place * self._decades)
        linear = self.lower + place * (self.upper - self.lower)
        return np.where(self._logarithmic, logarithmic, linear)

    def slope(self, shapes: Array) -> Array:
        """Return ∂shape/∂place (s,)."""
        return np.where(self._logarithmic, shapes * self._decades, self.upper - self.lower)

    def at_bound(self, shapes: Array) -> NDArray[np.bool_]:
        """Mark the shapes (s,) at an end of their range."""
        place = self.place(shapes)
        return np.asarray(np.minimum(place, 1.0 - place) < AT_BOUND)

    @cached_property
    def _logarithmic(self) -> NDArray[np.bool_]:
        return np.asarray(self.lower > 0.0)

    @cached_property
    def _decades(self) -> Array:
        safe = np.where(self._logarithmic, self.lower, 1.0)
        return np.where(self._logarithmic, np.log(np.maximum(self.upper, safe) / safe), 1.0)


def shapes_of_data(model: Model, segments: Sequence[Processed]) -> Array:
    """Return the shape parameters (s,) that the training recordings give, NaN for fitted ones.

    The ends of a signal's range are percentiles over all segments. The range of τ_load, which
    depends on the fit, is that of the measured torque.
    """
    every = ((p.joint, shape.data) for p in model.placements for shape in p.effect.shapes)
    ends = [np.nan if data is None else _end(data, joint, segments) for joint, data in every]
    return np.array(ends, dtype=float)


def _end(data: DataRange, joint: int, segments: Sequence[Processed]) -> float:
    name = "tau" if data.signal == "load" else data.signal
    of_all = [getattr(segment, name) for segment in segments]
    if any(values is None for values in of_all):
        return 0.0
    values = np.concatenate([x[:, joint if data.joint is None else data.joint] for x in of_all])
    if data.end == "size":
        return float(np.percentile(np.abs(values), 100.0 - TAIL))
    return float(np.percentile(values, TAIL if data.end == "low" else 100.0 - TAIL))
