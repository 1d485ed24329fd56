"""Candidates: every effect of the library on every joint, or pair of joints for couplings.

Their values are limited by what the motion resolves, and by checks: an ordered list of functions
that return why fitted values are implausible, or None.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import product
from typing import Literal

import casadi as ca
import numpy as np

from lieid_casadi.arrays import Array, Mask
from lieid_casadi.diagnosis.events import follows_commands, moves_enough
from lieid_casadi.effects import ArmEffect, Effect, Placement
from lieid_casadi.effects.effect import Signals
from lieid_casadi.effects.payload import AddedPayload, Payload
from lieid_casadi.effects.registry import make, usable
from lieid_casadi.identification.regression.resolved_shapes import least_resolved, shape_limits
from lieid_casadi.identification.regression.variable_projection import ShapeRange
from lieid_casadi.messages import in_unit
from lieid_casadi.model import Model
from lieid_casadi.recording import Processed
from lieid_casadi.recording.processed import recording_count

LEAST_TEMPERATURE_RANGE = 0.5  # °C, of a joint: less is the resolution of a sensor
GRID = 25  # values of one shape parameter; its square root for each of two
AT_BOUND = 0.02  # relative distance from a bound
LEAST_DELAY = 1.0  # samples: a velocity from differences is late by as much, commands are held

CourseKind = Literal["later", "wave"]


@dataclass(frozen=True, eq=False)
class Course:
    """A change in the course of a recording: from an instant on (``later``), or a slow ``wave``."""

    kind: CourseKind
    #: (G,) to try: times of the recording, or periods, s
    at: Array

    def factors(self, time: Array) -> Array:
        """Return what each column is multiplied by (R, G, f) at times (R,) of the recording."""
        if self.kind == "later":
            return np.asarray((time[:, None] >= self.at)[..., None], dtype=float)
        phase = 2.0 * np.pi * time[:, None] / self.at
        return np.stack([np.cos(phase), np.sin(phase)], axis=2)


@dataclass(frozen=True, eq=False)
class Candidate:
    """One effect in one place, with its shape parameters on a grid."""

    placement: Placement
    #: (G, s): values of the shape parameters to try, (1, 0) without any; of effects computed along
    #: a whole segment without shape parameters, coefficients at which their columns are evaluated
    grid: Array
    #: the one (from 0) in which it acts; None for all of them
    recording: int | None = None
    #: how it acts in the course of a recording; None for an effect that does not change
    course: Course | None = None
    #: independent values of a scanned shape parameter, of which its grid has the best
    scanned: float = 1.0

    def refined(self, points: Sequence[int], positions: Sequence[float]) -> Candidate:
        """Return the candidate with further grid points around the points of some indices.

        ``positions`` are relative to the distance to the neighbouring point, 0 to 1.
        """
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
            for end, part in product(ends, positions):
                place = places[point].copy()
                place[axis] = here + part * (end - here)
                more.append(ranges.shapes(place)[None])
        grid = np.unique(np.concatenate(more), axis=0)
        return replace(self, grid=grid)

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
        """Joints (from 0) as listed in results: one, or target and source."""
        return joints_of(self.placement)

    @property
    def joint(self) -> int:
        """The joint (from 0) whose rows it acts on first."""
        return self.placement.joint

    @property
    def reaches_all(self) -> bool:
        """Whether it acts on joints other than those listed in results."""
        return isinstance(self.effect, ArmEffect) and self.effect.reach != "joint"

    @property
    def by_estimate(self) -> bool:
        """Whether its columns depend on its coefficients, as those of delays and filters do."""
        effect = self.effect
        return isinstance(effect, ArmEffect) and not effect.shapes and not effect.linear

    def cell(self, point: int) -> tuple[float, float]:
        """Return the least and the largest value of a single coefficient at a grid point.

        A filter of half the time constant, twice as large, is more like a delay than filters are.
        """
        if not (self.by_estimate and self.of_arm and self.grid.shape[1] == 1):
            return -np.inf, np.inf
        here, others = self.grid[point, 0], self.grid[:, 0]
        below = others[others < here].max(initial=-np.inf)
        return 0.5 * (here + below), 0.5 * (here + others[others > here].min(initial=np.inf))

    @property
    def of_arm(self) -> bool:
        """Whether it acts in all recordings at all times, as an effect of the arm does."""
        return self.recording is None and self.course is None

    @property
    def label(self) -> str:
        """The effect as written on the command line: ``stribeck:4``."""
        where = "" if self.recording is None else f" in recording {self.recording + 1}"
        return (
            self.placement.label + where + ("" if self.course is None else f", {self.course.kind}")
        )

    @property
    def parameters(self) -> int:
        """Number of parameters that it adds to a model; recording and course are one each, too."""
        fitted = [shape for shape in self.effect.shapes if shape.data is None]
        chosen = (self.recording is not None) + (self.course is not None)
        each = 1 + (self.course is not None and self.course.kind == "wave")  # cosine and sine
        return each * len(self.effect.coefficients) + len(fitted) + chosen


def joints_of(placement: Placement) -> tuple[int, ...]:
    """Return the joints (from 0) that results list for a placement; none for the whole arm."""
    if placement.whole_arm:
        return ()
    if placement.source is None:
        return (placement.joint,)
    return (placement.joint, placement.source)


def list_candidates(
    model: Model,
    segments: Sequence[Processed],
    usable_joints: Mask,
    scan: Callable[[Effect, int], tuple[Array, float]],
    *,
    model_fixed: bool = False,
) -> tuple[Candidate, ...]:
    """Return the candidates for which the recordings have motion and signals.

    ``usable_joints`` (n,) have rows, which a joint that moves for instants has not. ``scan`` gives
    the grid (G, 1) of a shape parameter that is scanned, of an effect and a joint, and of how many
    values it is a choice. If the model is fixed, its effects are candidates too, as changes.
    """
    commanded = follows_commands(model.robot, [s.recording for s in segments])
    have = set() if model_fixed else {p.label for p in model.placements}
    moves = usable_joints & moves_enough(model.robot, segments)
    found: list[Candidate] = []
    if not moves.any():
        return ()
    recordings = recording_count(segments)
    for effect in usable(model.library)[0].values():
        if effect.option and not effect.whole_arm and (model_fixed or not is_form(effect)):
            continue  # of variants, only those of the whole arm and other forms
        if not effect.candidate or not _has_signals(effect, segments, commanded=commanded):
            continue
        if effect.per_recording and recordings > 1:
            effect = make(f"{effect.name}/{recordings}")
        if model_fixed:
            effect = incremental(effect, [p.effect.name for p in model.placements])
        scanned = any(shape.scan for shape in effect.shapes)
        for placement in _placements(effect, model.n):
            if placement.label in have or not moves[list(joints_of(placement))].all():
                continue
            j = placement.joint
            grid, tried = scan(effect, j) if scanned else (shape_grid(effect, segments, j), 1.0)
            if len(grid):
                found.append(Candidate(placement, grid, scanned=tried))
    return tuple(found)


class IncrementalEffect(Effect):
    """An effect added to a model that is kept, in place of, or together with, another effect."""

    def __init__(
        self, effect: Effect, replaced: Sequence[Effect], companions: Sequence[Effect]
    ) -> None:
        self.name = effect.name  # type: ignore[misc]
        self.option, self.formula = effect.option, effect.formula
        self.shapes, self.states, self.dry = effect.shapes, effect.states, effect.dry
        self._effect, self._replaced, self._companions = effect, replaced, companions
        every = (effect, *replaced, *companions)
        self.signals = tuple({signal for each in every for signal in each.signals})
        self.coefficients = sum((c.coefficients for c in companions), effect.coefficients)

    def columns(self, s: Signals, shape: Mapping[str, ca.SX]) -> Sequence[ca.SX]:
        """Return the columns of the change."""
        own = list(self._effect.columns(s, shape))
        for replaced in self._replaced:
            own[0] = own[0] - replaced.columns(s, {})[0]
        return own + [c for each in self._companions for c in each.columns(s, {})]

    def advance(self, before: Signals, now: Signals, shape: Mapping[str, ca.SX]) -> Sequence[ca.SX]:
        """Return the states after a step; ``before`` contains those at its beginning."""
        return self._effect.advance(before, now, shape)


def incremental(effect: Effect, present: Sequence[str]) -> Effect:
    """Return an effect as the change that it makes to a model with the named effects."""
    replaced = [make(name) for name in effect.replaces if name in present]
    companions = [make(name) for name in effect.accompanied_by]
    if isinstance(effect, Payload):
        return AddedPayload()
    return IncrementalEffect(effect, replaced, companions) if replaced or companions else effect


def shape_grid(effect: Effect, segments: Sequence[Processed], joint: int) -> Array:
    """Return shape parameters (G, s) to try on a joint, within what its motion resolves.

    For effects computed along a whole segment without shape parameters, coefficients (G, c).
    """
    if isinstance(effect, ArmEffect) and not effect.shapes:
        return np.array([(0.0,) * len(effect.coefficients), *effect.trial_values])
    if not effect.shapes:
        return np.zeros((1, 0))
    count = GRID if len(effect.shapes) == 1 else int(np.ceil(np.sqrt(GRID)))
    axes = []
    for shape in effect.shapes:
        lower, upper = shape_limits(shape, segments, joint)
        lower = shape.lower if shape.resolved_by == "distance" else lower  # a gate refuses these
        limited = replace(shape, lower=lower, upper=upper)
        places = np.linspace(0.0, 1.0, count + 2)[1:-1]
        axes.append(ShapeRange.of([limited]).shapes(places[:, None])[:, 0])
    return np.array(list(product(*axes)))


def _has_signals(effect: Effect, segments: Sequence[Processed], *, commanded: bool) -> bool:
    """Return whether the recordings have what an effect acts on: a torque signal, or commands."""
    if effect.commanded or effect.on_torque_signal:
        return commanded != effect.on_torque_signal
    measured = all(segment.temperature is not None for segment in segments)
    if effect.unless_measured == "temperature":
        values = [s.temperature for s in segments if s.temperature is not None]
        return not measured or np.ptp(np.vstack(values), axis=0).max() <= LEAST_TEMPERATURE_RANGE
    return "temperature" not in effect.signals or measured


def is_form(effect: Effect) -> bool:
    """Return whether an effect is a variant of friction over speed, or of a filter of the torque.

    Effects are compared with it; a path does not choose it.
    """
    variant = effect.option and not (effect.replaces or effect.free_options)
    own = isinstance(effect, ArmEffect) and not effect.whole_arm
    return bool(variant) and (own or follows_velocity(effect))


def is_delay(candidate: Candidate) -> bool:
    """Return whether an effect resembles dry friction that reverses late, and nothing else."""
    return candidate.effect.like_uncertain_friction == ("late",)


def follows_temperature(effect: Effect) -> bool:
    """Return whether an effect acts by a temperature, or stands for one that is not measured."""
    return "temperature" in (*effect.signals, effect.unless_measured)


def follows_velocity(effect: Effect) -> bool:
    """Return whether an effect is a function of its joint's velocity alone."""
    alone = not (effect.states or effect.couples or isinstance(effect, ArmEffect))
    return alone and bool(effect.signals) and {"dq", "sign"} >= set(effect.signals)


def _placements(effect: Effect, n: int) -> list[Placement]:
    if effect.whole_arm:
        return [Placement(effect, 0)]
    if effect.couples:
        return [Placement(effect, i, j) for i in range(n) for j in range(n) if i != j]
    return [Placement(effect, j) for j in range(n)]


#: Of a candidate, its shape parameters and its coefficients: why they are implausible.
Check = Callable[[Candidate, Array, Array, Sequence[Processed]], str | None]


def implausible_value(
    candidate: Candidate, shapes: Array, values: Array, segments: Sequence[Processed]
) -> str | None:
    """A coefficient outside the bounds that physics sets, or larger than on any real arm."""
    for coefficient, value in zip(candidate.effect.coefficients, values, strict=False):
        text = f"{coefficient.name} = {in_unit(f'{value:.3g}', coefficient.unit)} is"
        if not coefficient.lower <= value <= coefficient.upper:
            return f"{text} physically implausible"
        if abs(value) > coefficient.limit:
            return f"{text} larger than on a real arm (limit {coefficient.limit:g})"
    return None


def unresolved_shape(
    candidate: Candidate, shapes: Array, values: Array, segments: Sequence[Processed]
) -> str | None:
    """A shape parameter that the motion does not resolve, such as a velocity in the dead zone."""
    for shape, value in zip(candidate.effect.shapes, shapes, strict=False):
        if shape.data is not None:
            continue
        least = least_resolved(shape, segments, candidate.joint)
        size = f"{shape.name} = {in_unit(f'{value:.2g}', shape.unit)}"
        if value >= shape.upper * (1.0 - AT_BOUND):
            return f"{size} is at the upper end of its range"
        if value <= least * (1.0 + AT_BOUND):
            return f"{size} is below what this motion can resolve"
    return None


def below_one_sample(
    candidate: Candidate, shapes: Array, values: Array, segments: Sequence[Processed]
) -> str | None:
    """A delay of less than a sample where the signals themselves are uncertain by as much."""
    rate = min(segment.recording.rate for segment in segments)
    for coefficient, value in zip(candidate.effect.coefficients, values, strict=False):
        lead = coefficient.resolved_by == "lead" and value < 0.0
        sampled = lead or coefficient.resolved_by == "sample_time"
        if sampled and abs(value) * rate < LEAST_DELAY:
            return f"{coefficient.name} = {value:.2g} {coefficient.unit} is less than one sample"
    return None


#: In this order; the first reason counts.
CHECKS: tuple[Check, ...] = (implausible_value, unresolved_shape, below_one_sample)


def reason_against(
    candidate: Candidate, shapes: Array, values: Array, segments: Sequence[Processed]
) -> str | None:
    """Return the first reason of `CHECKS` against the fitted values of a candidate, or None.

    A change in the course of a recording may have either sign.
    """
    if candidate.course is not None:
        return None
    found = np.atleast_1d(values)
    reasons = (check(candidate, shapes, found, segments) for check in CHECKS)
    return next((reason for reason in reasons if reason is not None), None)
