"""Ranges of shape parameters, and the scale on which they are searched."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
AT_BOUND = 1e-3  # of the range: a shape nearer to its end counts as at the bound


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
