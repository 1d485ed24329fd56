"""Rival effects on a fit, and what of one the other's refit leaves along a motion."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import permutations, product

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import qr

from lieid_casadi.compiled import Compiled, compile
from lieid_casadi.effects import Placement
from lieid_casadi.effects.placement import place
from lieid_casadi.errors import EffectError
from lieid_casadi.excitation.basis.trajectory import MotionSamples
from lieid_casadi.identification import Fit
from lieid_casadi.identification.regression.segment_columns import effects_along
from lieid_casadi.identification.regression.shape_range import ShapeRange
from lieid_casadi.model import Model
from lieid_casadi.recording import Processed, Recording

Array = NDArray[np.float64]
GRID = 25  # shapes at which a rival's refit is tried; its square root for each of two
FINE_GRID = 81  # the same for the numbers that are reported
RANK = 1e-9
AT_REST = 2e-3  # of the velocity limit: below it friction is undetermined, and no evidence


@dataclass(frozen=True, eq=False)
class Rival:
    """One effect with the size that it is thought to have.

    Attributes
    ----------
    compiled : Compiled
        The common model and this effect, whose columns are the last ones.
    coefficients : (c,)
        NaN where nothing is stated or fitted yet.
    shapes : (s,)
    grid : (G, s)
        Shapes that its refit may take; the first is its own.
    """

    placement: Placement
    compiled: Compiled
    coefficients: Array
    shapes: Array
    grid: Array

    @property
    def label(self) -> str:
        """As written in files: ``stribeck:4``."""
        return self.placement.label

    @property
    def parameters(self) -> int:
        """How many numbers it adds to a model."""
        return len(self.coefficients) + len(self.shapes)


@dataclass(frozen=True, eq=False)
class Stacked:
    """Columns along a motion, all joints' rows stacked and weighted.

    A vector's squared length is the noncentrality that one period contributes.

    Attributes
    ----------
    common : (R, r)
        Orthonormal: the span of the base columns and of the effects that all rivals share.
    columns : tuple of (G, R, c)
        Of each rival.
    """

    common: Array
    columns: tuple[Array, ...]

    def rest(self, columns: Array) -> Array:
        """Return what the common columns leave of (R, c), projected twice against rounding."""
        for _ in range(2):
            columns = columns - self.common @ (self.common.T @ columns)
        return columns

    @cached_property
    def remaining(self) -> tuple[tuple[Array, ...], ...]:
        """What the common columns leave of each rival's, for each of its shapes."""
        return tuple(tuple(self.rest(c) for c in each) for each in self.columns)

    def unexplained(self, true: int, rival: int, coefficients: Array) -> Array:
        """Return the weighted torque (R,) of one effect that the other's best refit leaves."""
        torque = self.remaining[true][0] @ coefficients
        best: Array = torque
        for own in self.remaining[rival]:
            scale = np.linalg.norm(own, axis=0)
            basis = _span(own / np.where(scale > 0.0, scale, 1.0))
            left = torque - basis @ (basis.T @ torque)
            if left @ left < best @ best:
                best = left
        return best


class Rivals:
    """Rival effects beside what they share.

    Parameters
    ----------
    independent_rate : (n,)
        Independent samples per second of each joint's residual.
    duration : float
        Of one period, s.
    """

    def __init__(
        self,
        fit: Fit,
        effects: Sequence[str],
        sizes: Mapping[str, Sequence[float]],
        *,
        independent_rate: Array,
        duration: float,
        velocity: Array,
    ) -> None:
        self.fit, self.duration, self.independent_rate = fit, duration, independent_rate
        placements = rival_placements(effects, fit.model.n)
        unknown = sorted(set(sizes) - {p.label for p in placements})
        if unknown:
            raise EffectError(f"size of {unknown[0]}: not among the effects to tell apart")
        labels = {p.label for p in placements}
        kept = [p for p in fit.model.placements if p.label not in labels]
        self.common = Model.of_placements(fit.model.robot, kept)
        self.compiled = compile(self.common)
        self._dead_zone = AT_REST * velocity
        self.rivals = tuple(self._rival(p, sizes.get(p.label)) for p in placements)

    @property
    def pairs(self) -> list[tuple[int, int]]:
        """Every (true, rival)."""
        return list(permutations(range(len(self.rivals)), 2))

    def along(self, motion: MotionSamples) -> Stacked:
        """Return all columns along one period."""
        segment = self._segment(motion)
        weight = self._weight(motion)
        links = self.fit.link_parameters
        _, coefficients, shapes = self._numbers(self.common.placements)
        parameters = np.concatenate([links, coefficients])
        effects = effects_along(self.compiled, segment, shapes, parameters)
        rigid = self.compiled.regressor(motion.q, motion.dq, motion.ddq)
        full = np.concatenate([rigid, effects], axis=2)[:, :, list(self.common.base.kept)]
        stacked = _flat(full, weight)
        scale = np.linalg.norm(stacked, axis=0)
        common = _span(stacked / np.where(scale > 0.0, scale, 1.0))
        columns = []
        for rival in self.rivals:
            own = np.nan_to_num(rival.coefficients)
            numbers = np.concatenate([parameters, own])
            each = [
                effects_along(rival.compiled, segment, np.concatenate([shapes, shape]), numbers)
                for shape in rival.grid
            ]
            columns.append(np.array([_flat(c[:, :, -len(own) :], weight) for c in each]))
        return Stacked(common, tuple(columns))

    def sized(self, motions: Sequence[MotionSamples]) -> None:
        """Give effects without a size that of the fitted or stated ones, else of the noise.

        By the RMS torque that their columns have, equal parts of it, in the mean of motions.
        """
        squares = [np.zeros(len(r.coefficients)) for r in self.rivals]
        torques = np.zeros(len(self.rivals))
        for stacked in map(self.along, motions):
            for k, (rival, columns) in enumerate(zip(self.rivals, stacked.columns, strict=True)):
                squares[k] += (columns[0] ** 2).sum(axis=0) / len(motions)
                torques[k] += ((columns[0] @ rival.coefficients) ** 2).sum() / len(motions)
        known = torques[np.isfinite(torques)]
        made = []
        for rival, square in zip(self.rivals, squares, strict=True):
            joint = rival.placement.joint
            noise = self.independent_rate[joint] * self.duration
            level = float(known.max()) if len(known) else noise
            if np.isnan(rival.coefficients).any():
                acts = square > 0.0
                if not acts.any():
                    raise EffectError(f"{rival.label}: has no torque along any motion tried")
                each = level / acts.sum() / np.where(acts, square, 1.0)
                rival = replace(rival, coefficients=np.where(acts, np.sqrt(each), 0.0))
            made.append(rival)
        self.rivals = tuple(made)

    def finer(self) -> None:
        """Let refits take more shapes: what a search exploited between them is lost again."""
        self.rivals = tuple(
            replace(r, grid=_grid(r.placement, r.shapes, FINE_GRID)) for r in self.rivals
        )

    def torque_weight(self) -> Array:
        """Return 1/N·m (n,): what a torque of 1 N·m weighs per √sample of one period."""
        return np.asarray(np.sqrt(self.independent_rate * self.duration) / self.fit.noise)

    def _weight(self, motion: MotionSamples) -> Array:
        moving = np.abs(motion.dq) > self._dead_zone
        return np.asarray(moving * self.torque_weight() / np.sqrt(len(motion)))

    def _segment(self, motion: MotionSamples) -> Processed:
        recording = Recording.from_arrays(motion.t, motion.q, motion.dq, np.zeros_like(motion.q))
        return Processed(
            t=motion.t, q=motion.q, dq=motion.dq, ddq=motion.ddq, tau=None, temperature=None,
            payload_label=None, recording=recording, rate=len(motion) / self.duration,
            cutoff=self.fit.processing.cutoff or 1.0, dead_zone=self._dead_zone,
            moving=np.abs(motion.dq) > self._dead_zone, options=self.fit.processing,
        )  # fmt: skip

    def _rival(self, placement: Placement, size: Sequence[float] | None) -> Rival:
        effect = placement.effect
        count = len(effect.coefficients)
        initial = [shape.initial for shape in effect.shapes]
        numbers = np.array([np.nan] * count + initial)
        have = {p.label for p in self.fit.model.placements}
        if size is not None:
            if len(size) not in (count, len(numbers)) or not np.all(np.isfinite(size)):
                names = [c.name for c in effect.coefficients] + [s.name for s in effect.shapes]
                raise EffectError(
                    f"size of {placement.label}: {len(size)} numbers; expected "
                    f"{', '.join(names)} ({count} at least)"
                )
            numbers[: len(size)] = size
            if not numbers[:count].any():
                raise EffectError(f"size of {placement.label}: zero, an effect that is not there")
        elif placement.label in have:
            _, coefficients, shapes = self._numbers([placement])
            numbers = np.concatenate([coefficients, shapes])
        model = Model.of_placements(self.common.robot, (*self.common.placements, placement))
        own = numbers[count:]
        return Rival(placement, compile(model), numbers[:count], own, _grid(placement, own))

    def _numbers(self, placements: Sequence[Placement]) -> tuple[list[str], Array, Array]:
        """Return labels, coefficients and shapes that the fit has for placements."""
        coefficients: dict[str, Array] = {}
        shapes: dict[str, Array] = {}
        c = s = 0
        for p in self.fit.model.placements:
            last_c, last_s = c + len(p.effect.coefficients), s + len(p.effect.shapes)
            coefficients[p.label] = self.fit.effect_coefficients[c:last_c]
            shapes[p.label] = self.fit.shapes[s:last_s]
            c, s = last_c, last_s
        names = [p.label for p in placements]
        empty = np.zeros(0)
        return (
            names,
            np.concatenate([empty, *(coefficients[name] for name in names)]),
            np.concatenate([empty, *(shapes[name] for name in names)]),
        )


def rival_placements(effects: Sequence[str], n: int) -> list[Placement]:
    """Return the placements of rival effects.

    Raises
    ------
    EffectError
        Fewer than two, one given twice, unknown, on several joints, or one that needs what a
        trajectory does not set.
    """
    found: list[Placement] = []
    for spec in effects:
        placed = place(spec, n)
        if len(placed) != 1:
            raise EffectError(f"effect {spec}: on {len(placed)} joints; expected one, as {spec}:1")
        (placement,) = placed
        if any(placement.label == other.label for other in found):
            raise EffectError(f"effect {placement.label} is given twice")
        if "temperature" in placement.effect.signals:
            raise EffectError(f"{placement.label} needs a temperature; no trajectory sets that")
        found.append(placement)
    if len(found) < 2:
        raise EffectError(f"{len(found)} effect; expected two at least to tell apart")
    return found


def _grid(placement: Placement, own: Array, points: int = GRID) -> Array:
    """Return shapes (G, s): its own, the initial ones, and about so many over their ranges."""
    if not len(own):
        return np.zeros((1, 0))
    ranges = ShapeRange.of(placement.effect.shapes)
    count = max(3, round(points ** (1 / len(own))))
    places = product(np.linspace(0.0, 1.0, count), repeat=len(own))
    initial = [shape.initial for shape in placement.effect.shapes]
    return np.array([own, initial, *(ranges.shapes(np.array(p)) for p in places)])


def _flat(columns: Array, weight: Array) -> Array:
    """Return columns (N, n, k) as weighted rows (N n, k)."""
    return np.asarray((columns * weight[:, :, None]).reshape(-1, columns.shape[2]))


def _span(columns: Array) -> Array:
    """Return an orthonormal basis of columns (R, k) of about unit length."""
    basis, triangle, _ = qr(columns, mode="economic", pivoting=True)
    sizes = np.abs(np.diag(triangle))
    return np.asarray(basis[:, sizes > RANK * max(float(sizes.max(initial=0.0)), 1e-300)])
