"""What could be missing: every effect of the library on every joint, every pair for couplings."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np
from numpy.typing import NDArray

from lieid_casadi.effects import Effect, Placement
from lieid_casadi.effects.effect import REGISTER, make
from lieid_casadi.identification.shape_range import ShapeRange
from lieid_casadi.model import Model
from lieid_casadi.recording import Processed

Array = NDArray[np.float64]
GRID = 25  # values of one shape parameter that are tried; the square root of it each for two
ZOOM = (1 / 3, 2 / 3)  # of the way to the next point, where a grid is refined
#: Other forms of an effect that stands in the list by its plain name, and models that take the
#: place of coulomb and viscous instead of standing beside them.
NOT_TRIED = ("sigmoid_friction",)


@dataclass(frozen=True, eq=False)
class Candidate:
    """One effect in one place, with its shape parameters on a grid.

    Attributes
    ----------
    placement : Placement
    grid : (G, s)
        Values of the shape parameters that are tried; (1, 0) without any.
    """

    placement: Placement
    grid: Array

    @property
    def key(self) -> str:
        """What its columns depend on beside the fit: its label and its grid."""
        return f"{self.placement.label}{self.grid.tobytes().hex()}"

    def zoomed(self, points: Sequence[int]) -> Candidate:
        """Return it with more points of its grid beside some of them."""
        if not self.grid.shape[1]:
            return self
        ranges = ShapeRange.of(self.effect.shapes)
        places = ranges.place(self.grid)
        more = [self.grid]
        for point, axis in product(points, range(places.shape[1])):
            at = np.unique(places[:, axis])
            here = places[point, axis]
            below, above = at[at < here - 1e-9], at[at > here + 1e-9]
            ends = [below.max() if len(below) else 0.0, above.min() if len(above) else 1.0]
            for end, part in product(ends, ZOOM):
                place = places[point].copy()
                place[axis] = here + part * (end - here)
                more.append(ranges.shapes(place)[None])
        grid = np.unique(np.concatenate(more), axis=0)
        return Candidate(self.placement, grid)

    @property
    def effect(self) -> Effect:
        """The effect."""
        return self.placement.effect

    @property
    def name(self) -> str:
        """The effect's name, without option."""
        return self.placement.effect.name

    @property
    def joints(self) -> tuple[int, ...]:
        """Joints (from 0) as they stand in results: one, or target and source."""
        return joints_of(self.placement)

    @property
    def joint(self) -> int:
        """The joint (from 0) whose rows it acts on first."""
        return self.placement.joint

    @property
    def lower(self) -> tuple[float, ...]:
        """Least values of its coefficients."""
        return tuple(coefficient.lower for coefficient in self.effect.coefficients)

    @property
    def parameters(self) -> int:
        """How many numbers it adds to a model."""
        return len(self.effect.coefficients) + len(self.effect.shapes)


def joints_of(placement: Placement) -> tuple[int, ...]:
    """Return the joints (from 0) that a placement names in results."""
    if placement.source is None:
        return (placement.joint,)
    return (placement.joint, placement.source)


def candidates(model: Model, segments: Sequence[Processed]) -> tuple[Candidate, ...]:
    """Return all that the model has not, as far as the recordings have the signals for it."""
    have = {p.label for p in model.placements}
    moves = np.any([s.moving.any(axis=0) for s in segments], axis=0)
    found = []
    for label in REGISTER:
        effect = make(label)
        if effect.option or effect.name in NOT_TRIED or not _has_signals(effect, segments):
            continue
        grid = shape_grid(effect, segments)
        for placement in _places(effect, model.n):
            joints = joints_of(placement)
            if placement.label not in have and moves[list(joints)].all():
                found.append(Candidate(placement, grid))
    return tuple(found)


def shape_grid(effect: Effect, segments: Sequence[Processed]) -> Array:
    """Return the shape parameters to try (G, s)."""
    if not effect.shapes:
        return np.zeros((1, 0))
    count = GRID if len(effect.shapes) == 1 else int(np.ceil(np.sqrt(GRID)))
    axes = []
    for shape in effect.shapes:
        places = np.linspace(0.0, 1.0, count + 2)[1:-1]
        values = ShapeRange.of([shape]).shapes(places[:, None])[:, 0]
        if shape.unit == "s":
            longest = max(segment.t[-1] - segment.t[0] for segment in segments)
            lower = max(shape.lower, 0.05 * longest)
            values = np.geomspace(lower, min(shape.upper, max(2.0 * longest, 2 * lower)), 5)
        axes.append(values)
    return np.array(list(product(*axes)))


def _has_signals(effect: Effect, segments: Sequence[Processed]) -> bool:
    if "temperature" not in effect.signals:
        return True
    return all(segment.temperature is not None for segment in segments)


def _places(effect: Effect, n: int) -> list[Placement]:
    if effect.couples:
        return [Placement(effect, i, j) for i in range(n) for j in range(n) if i != j]
    return [Placement(effect, j) for j in range(n)]
