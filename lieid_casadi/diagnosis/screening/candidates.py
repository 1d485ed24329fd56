"""What could be missing: every effect of the library on every joint, every pair for couplings."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import product

import numpy as np
from numpy.typing import NDArray

from lieid_casadi.diagnosis.screening.incremental_effect import as_change
from lieid_casadi.effects import ArmEffect, Effect, Placement, Shape
from lieid_casadi.effects.effect import REGISTER, make
from lieid_casadi.identification.regression.shape_range import ShapeRange
from lieid_casadi.model import Model
from lieid_casadi.recording import Processed

Array = NDArray[np.float64]
GRID = 25  # values of one shape parameter that are tried; the square root of it each for two
#: Time constants over the longest segment; speeds over the joint's dead zone and top speed:
#: beyond these a shape is noise at a reversal, or just another polynomial.
SHORTEST, LONGEST = 0.05, 2.0
DEAD_ZONES, FASTEST = 3.0, 0.35
ZOOM = (1 / 3, 2 / 3)  # of the way to the next point, where a grid is refined
#: Other forms of an effect that stands in the list by its plain name, and models that take the
#: place of coulomb and viscous instead of standing beside them.
NOT_TRIED = ("sigmoid_friction",)
#: Peaks of a periodogram whose columns are looked at, for each joint.
PEAKS = 8


@dataclass(frozen=True, eq=False)
class Candidate:
    """One effect in one place, with its shape parameters on a grid.

    Attributes
    ----------
    placement : Placement
    grid : (G, s)
        Values of the shape parameters that are tried; (1, 0) without any. For effects on the
        whole arm, coefficients at which their columns are tried.
    """

    placement: Placement
    grid: Array

    @property
    def key(self) -> str:
        """What its columns depend on beside the fit: its label and its grid."""
        return f"{self.placement.label}{self.grid.tobytes().hex()}"

    def zoomed(self, points: Sequence[int]) -> Candidate:
        """Return it with more points of its grid beside some of them."""
        if not self.effect.shapes:
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
    def reaches_all(self) -> bool:
        """Whether it acts on joints other than those that it names."""
        return isinstance(self.effect, ArmEffect) and self.effect.reach != "joint"

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
    if placement.whole_arm:
        return ()
    if placement.source is None:
        return (placement.joint,)
    return (placement.joint, placement.source)


def candidates(
    model: Model,
    segments: Sequence[Processed],
    scan: Callable[[Effect, int], Array],
    *,
    present: bool = False,
) -> tuple[Candidate, ...]:
    """Return all that the model has not, as far as the recordings have the signals for it.

    ``scan`` gives the grid of an effect on a joint whose shape parameter has to be scanned;
    ``present`` takes in effects that the model has.
    """
    have = set() if present else {p.label for p in model.placements}
    moves = np.any([s.moving.any(axis=0) for s in segments], axis=0)
    found = []
    for label in REGISTER:
        effect = make(label)
        if effect.option or effect.name in NOT_TRIED or not _has_signals(effect, segments):
            continue
        if present:
            effect = as_change(effect, [p.effect.name for p in model.placements])
        scanned = any(shape.scan for shape in effect.shapes)
        for placement in _places(effect, model.n):
            joints = joints_of(placement)
            if placement.label in have or not moves[list(joints)].all():
                continue
            j = placement.joint
            grid = scan(effect, j) if scanned else shape_grid(effect, segments, j)
            if len(grid):
                found.append(Candidate(placement, grid))
    return tuple(found)


def shape_grid(effect: Effect, segments: Sequence[Processed], joint: int) -> Array:
    """Return the values to try on a joint (G, s): shape parameters within what it can show."""
    if isinstance(effect, ArmEffect):
        return np.array([(0.0,) * len(effect.coefficients), *effect.trial_values])
    if not effect.shapes:
        return np.zeros((1, 0))
    count = GRID if len(effect.shapes) == 1 else int(np.ceil(np.sqrt(GRID)))
    axes = []
    for shape in effect.shapes:
        lower, upper = shape_limits(shape, segments, joint)
        limited = replace(shape, lower=lower, upper=upper)
        places = np.linspace(0.0, 1.0, count + 2)[1:-1]
        axes.append(ShapeRange.of([limited]).shapes(places[:, None])[:, 0])
    return np.array(list(product(*axes)))


def shape_limits(shape: Shape, segments: Sequence[Processed], joint: int) -> tuple[float, float]:
    """Return bounds within what a joint's motion can show, by the shape parameter's unit."""
    if shape.unit == "s":
        longest = max(float(segment.t[-1] - segment.t[0]) for segment in segments)
        low, high = SHORTEST * longest, LONGEST * longest
    elif shape.unit == "rad/s" and shape.lower > 0.0:
        top = max(float(np.percentile(np.abs(s.dq[:, joint]), 99.0)) for s in segments)
        low = DEAD_ZONES * max(float(s.dead_zone[joint]) for s in segments)
        high = FASTEST * top
    else:
        return shape.lower, shape.upper
    low = min(max(low, shape.lower), 0.5 * shape.upper)
    return low, min(max(high, 2.0 * low), shape.upper)


def _has_signals(effect: Effect, segments: Sequence[Processed]) -> bool:
    if "temperature" not in effect.signals:
        return True
    return all(segment.temperature is not None for segment in segments)


def _places(effect: Effect, n: int) -> list[Placement]:
    if effect.whole_arm:
        return [Placement(effect, 0)]
    if effect.couples:
        return [Placement(effect, i, j) for i in range(n) for j in range(n) if i != j]
    return [Placement(effect, j) for j in range(n)]
