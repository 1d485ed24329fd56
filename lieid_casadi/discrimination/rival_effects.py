"""Rival effects on a fit, and how well a motion separates them."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import permutations, product

import numpy as np
from scipy.linalg import qr
from scipy.optimize import brentq
from scipy.stats import chi2, ncx2

from lieid_casadi.arrays import Array
from lieid_casadi.compiled import Compiled, compile
from lieid_casadi.discrimination.discrimination import RivalPair
from lieid_casadi.effects import Placement
from lieid_casadi.effects.placement import place
from lieid_casadi.errors import EffectError, NoSolution
from lieid_casadi.excitation.trajectory import MotionSamples
from lieid_casadi.identification import Fit
from lieid_casadi.identification.regression.segment_columns import effects_along
from lieid_casadi.identification.regression.variable_projection import ShapeRange
from lieid_casadi.model import Model
from lieid_casadi.recording import Processed, Recording

RANK_TOLERANCE = 1e-9


@dataclass(frozen=True, eq=False)
class StackedColumns:
    """Columns along a motion, the rows of all joints stacked and weighted.

    The squared length of a vector is the noncentrality that one period contributes.

    Attributes
    ----------
    common : (R, r)
        Orthonormal basis of the base columns and of the effects that all rivals share.
    columns : tuple of (G, R, c)
        Of each rival, at the shape parameters of its grid.
    """

    common: Array
    columns: tuple[Array, ...]

    def outside_model(self, columns: Array) -> Array:
        """Return the part of columns (R, c) outside the common span.

        The projection is applied twice, against rounding.
        """
        for _ in range(2):
            columns = columns - self.common @ (self.common.T @ columns)
        return columns

    @cached_property
    def remaining_columns(self) -> tuple[tuple[Array, ...], ...]:
        """Columns of each rival outside the common span, at each point of its grid."""
        return tuple(tuple(self.outside_model(c) for c in each) for each in self.columns)

    def unexplained(self, true: int, rival: int, coefficients: Array) -> Array:
        """Return the weighted torque (R,) of one effect that the best refit of another leaves."""
        torque = self.remaining_columns[true][0] @ coefficients
        best: Array = torque
        for own in self.remaining_columns[rival]:
            scale = np.linalg.norm(own, axis=0)
            basis = span_basis(own / np.where(scale > 0.0, scale, 1.0))
            left = torque - basis @ (basis.T @ torque)
            if left @ left < best @ best:
                best = left
        return best


def span_basis(columns: Array) -> Array:
    """Return an orthonormal basis of columns (R, k) of about unit length."""
    basis, triangle, _ = qr(columns, mode="economic", pivoting=True)
    sizes = np.abs(np.diag(triangle))
    return np.asarray(basis[:, sizes > RANK_TOLERANCE * max(float(sizes.max(initial=0.0)), 1e-300)])


GRID = 25  # values of a shape parameter in a rival's refit; the square root for each of two
FINE_GRID = 81  # the same for the result
AT_REST = 2e-3  # relative to the velocity limit, below which friction is undetermined


@dataclass(frozen=True, eq=False)
class RivalEffect:
    """One effect with its assumed size.

    Attributes
    ----------
    compiled : Compiled
        The common model with this effect, whose columns are the last ones.
    coefficients : (c,)
        NaN where none are stated or fitted.
    shapes : (s,)
        Shape parameters.
    grid : (G, s)
        Shape parameters of its refit; the first row is ``shapes``.
    """

    placement: Placement
    compiled: Compiled
    coefficients: Array
    shapes: Array
    grid: Array

    @property
    def label(self) -> str:
        """As on the command line: ``stribeck:4``."""
        return self.placement.label

    @property
    def parameters(self) -> int:
        """Number of parameters that it adds to a model."""
        return len(self.coefficients) + len(self.shapes)


class RivalEffects:
    """Rival effects, and the model that they have in common."""

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
        labels = {p.label for p in placements}
        kept = [p for p in fit.model.placements if p.label not in labels]
        self.common = Model.of_placements(fit.model.robot, kept)
        self.compiled = compile(self.common)
        self._dead_zone = AT_REST * velocity
        self.effects = tuple(self._rival(p, sizes.get(p.label)) for p in placements)

    @property
    def pairs(self) -> list[tuple[int, int]]:
        """Every (true, rival)."""
        return list(permutations(range(len(self.effects)), 2))

    def columns_along(self, motion: MotionSamples) -> StackedColumns:
        """Return the columns of the common model and of all rivals along one period."""
        segment = self._segment(motion)
        weight = self._weight(motion)
        links = self.fit.link_parameters
        coefficients, shapes = fitted_numbers(self.fit, self.common.placements)
        parameters = np.concatenate([links, coefficients])
        effects = effects_along(self.compiled, segment, shapes, parameters)
        rigid = self.compiled.regressor(motion.q, motion.dq, motion.ddq)
        full = np.concatenate([rigid, effects], axis=2)[:, :, list(self.common.base.kept)]
        stacked = _flat(full, weight)
        scale = np.linalg.norm(stacked, axis=0)
        common = span_basis(stacked / np.where(scale > 0.0, scale, 1.0))
        columns = []
        for rival in self.effects:
            own = np.nan_to_num(rival.coefficients)
            numbers = np.concatenate([parameters, own])
            each = [
                effects_along(rival.compiled, segment, np.concatenate([shapes, shape]), numbers)
                for shape in rival.grid
            ]
            columns.append(np.array([_flat(c[:, :, -len(own) :], weight) for c in each]))
        return StackedColumns(common, tuple(columns))

    def assign_sizes(self, motions: Sequence[MotionSamples]) -> None:
        """Assign sizes to effects that have none.

        Their RMS torque is that of the largest stated or fitted effect, or of the noise, in equal
        parts for each column, averaged over motions.
        """
        squares = [np.zeros(len(r.coefficients)) for r in self.effects]
        torques = np.zeros(len(self.effects))
        for stacked in map(self.columns_along, motions):
            for k, (rival, columns) in enumerate(zip(self.effects, stacked.columns, strict=True)):
                squares[k] += (columns[0] ** 2).sum(axis=0) / len(motions)
                torques[k] += ((columns[0] @ rival.coefficients) ** 2).sum() / len(motions)
        available = torques[np.isfinite(torques)]
        made = []
        for rival, square in zip(self.effects, squares, strict=True):
            joint = rival.placement.joint
            noise = self.independent_rate[joint] * self.duration
            level = float(available.max()) if len(available) else noise
            if np.isnan(rival.coefficients).any():
                acts = square > 0.0
                if not acts.any():
                    raise EffectError(
                        f"{rival.label}: has no torque along any of the motions tried; choose "
                        "another joint or start pose"
                    )
                each = level / acts.sum() / np.where(acts, square, 1.0)
                rival = replace(rival, coefficients=np.where(acts, np.sqrt(each), 0.0))
            made.append(rival)
        self.effects = tuple(made)

    def refine_grids(self) -> None:
        """Use finer grids of shape parameters in the refits.

        A search may have used the gaps between the points of the coarse grids.
        """
        self.effects = tuple(
            replace(r, grid=_grid(r.placement, r.shapes, FINE_GRID)) for r in self.effects
        )

    def torque_weight(self) -> Array:
        """Return the weight (n,) of a torque of 1 N·m per √sample of one period, 1/(N·m)."""
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

    def _rival(self, placement: Placement, size: Sequence[float] | None) -> RivalEffect:
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
                    f"{', '.join(names)} (at least {count})"
                )
            numbers[: len(size)] = size
            if not numbers[:count].any():
                raise EffectError(
                    f"size of {placement.label}: zero; expected a coefficient that is not zero"
                )
        elif placement.label in have:
            numbers = np.concatenate(fitted_numbers(self.fit, [placement]))
        model = Model.of_placements(self.common.robot, (*self.common.placements, placement))
        own = numbers[count:]
        return RivalEffect(placement, compile(model), numbers[:count], own, _grid(placement, own))


def fitted_numbers(fit: Fit, placements: Sequence[Placement]) -> tuple[Array, Array]:
    """Return the coefficients and the shape parameters that a fit has for placements."""
    numbers: dict[str, tuple[Array, Array]] = {}
    c = s = 0
    for p in fit.model.placements:
        last_c, last_s = c + len(p.effect.coefficients), s + len(p.effect.shapes)
        numbers[p.label] = fit.effect_coefficients[c:last_c], fit.shapes[s:last_s]
        c, s = last_c, last_s
    found = [(np.zeros(0), np.zeros(0)), *(numbers[p.label] for p in placements)]
    coefficients, shapes = zip(*found, strict=True)
    return np.concatenate(coefficients), np.concatenate(shapes)


def groups_of(
    effects: Sequence[str] | Sequence[Sequence[str]], sizes: Mapping[str, Sequence[float]]
) -> list[list[str]]:
    """Return the groups of rivals; a sequence of effects is one group."""
    groups = [list(effect) for effect in effects if not isinstance(effect, str)]
    alone = [effect for effect in effects if isinstance(effect, str)]
    if alone or not groups:
        groups.insert(0, alone)
    unknown = sorted(set(sizes).difference(*groups))
    if unknown:
        raise EffectError(f"size of {unknown[0]}: not one of the rival effects")
    return groups


def rival_placements(effects: Sequence[str], n: int) -> list[Placement]:
    """Return the placements of rival effects."""
    found: list[Placement] = []
    for spec in effects:
        placed = place(spec, n)
        if len(placed) != 1:
            raise EffectError(f"effect {spec}: on {len(placed)} joints; expected one, as {spec}:1")
        (placement,) = placed
        if any(placement.label == other.label for other in found):
            raise EffectError(f"effect {placement.label} is given twice")
        needs = "commands" if placement.effect.commanded else ""
        needs = "a temperature" if "temperature" in placement.effect.signals else needs
        if needs:
            raise EffectError(
                f"{placement.label} needs {needs}, which a trajectory does not determine"
            )
        found.append(placement)
    if len(found) < 2:
        raise EffectError(f"{len(found)} effect; expected at least two rivals")
    return found


def _grid(placement: Placement, own: Array, points: int = GRID) -> Array:
    """Return shape parameters (G, s): its own, the initial ones, and a grid over their ranges."""
    if not any(shape.data is None for shape in placement.effect.shapes):
        return own[None]
    ranges = ShapeRange.of(placement.effect.shapes)
    count = max(3, round(points ** (1 / len(own))))
    places = product(np.linspace(0.0, 1.0, count), repeat=len(own))
    initial = [shape.initial for shape in placement.effect.shapes]
    return np.array([own, initial, *(ranges.shapes(np.array(p)) for p in places)])


def _flat(columns: Array, weight: Array) -> Array:
    """Return columns (N, n, k) as weighted rows (N n, k)."""
    return np.asarray((columns * weight[:, :, None]).reshape(-1, columns.shape[2]))


ALIAS = 1e-6  # part of an effect below which no data can identify it; the diagnosis uses the same


def noncentrality_needed(parameters: int, level: float) -> float:
    """Return the noncentrality at which χ² rejects at 1 − level with probability level."""
    threshold = chi2.ppf(level, parameters)
    return float(brentq(lambda x: ncx2.sf(threshold, parameters, x) - level, 1e-6, 1e3))


def noncentrality(rivals: RivalEffects, stacked: StackedColumns, true: int, rival: int) -> float:
    """Return the noncentrality of one period if one effect is true and the other is fitted."""
    left = stacked.unexplained(true, rival, rivals.effects[true].coefficients)
    return float(left @ left)


def separable_pairs(rivals: RivalEffects, tried: Sequence[StackedColumns]) -> list[tuple[int, int]]:
    """Return the pairs (true, rival) that some of the motions tried can separate."""
    for k, effect in enumerate(rivals.effects):
        if max(_part_outside_model(stacked, k, rivals) for stacked in tried) < ALIAS:
            raise NoSolution(
                f"{effect.label}: other parameters of the model absorb it along any motion, so "
                "that no data can identify it. Leave it out, or fix the parameters that absorb it"
            )
    separable = [
        pair
        for pair in rivals.pairs
        if max(_remaining(rivals, stacked, *pair) for stacked in tried) >= ALIAS
    ]
    for a, b in rivals.pairs:
        if (a, b) not in separable and (b, a) not in separable:
            one, other = rivals.effects[a].label, rivals.effects[b].label
            raise NoSolution(
                f"{one} and {other} of these sizes explain the same torque along any motion, so "
                "that no data can separate them. Leave one of them out, or state other sizes"
            )
    return separable


def rival_pairs(
    rivals: RivalEffects,
    stacked: StackedColumns,
    separable: Collection[tuple[int, int]],
    *,
    level: float,
    samples: int,
) -> tuple[RivalPair, ...]:
    """Return the result for each pair along a motion."""
    weight = rivals.torque_weight()
    found = []
    for pair in rivals.pairs:
        true, other = (rivals.effects[k] for k in pair)
        left = stacked.unexplained(*pair, true.coefficients)
        found.append(
            RivalPair(
                true=true.label,
                rival=other.label,
                noncentrality=float(left @ left),
                needed=noncentrality_needed(true.parameters, level),
                remaining=_remaining(rivals, stacked, *pair),
                separable=pair in separable,
                residual=left.reshape(samples, -1) * np.sqrt(samples) / weight,
            )
        )
    return tuple(found)


def _part_outside_model(stacked: StackedColumns, index: int, rivals: RivalEffects) -> float:
    """Return the part (0 to 1) of an effect's torque that the common model does not span."""
    own = stacked.columns[index][0] @ rivals.effects[index].coefficients
    left = stacked.outside_model(own[:, None])
    return float(np.linalg.norm(left)) / max(float(np.linalg.norm(own)), 1e-300)


def _remaining(rivals: RivalEffects, stacked: StackedColumns, true: int, rival: int) -> float:
    """Return the part (0 to 1) of an effect's torque that the rival's refit leaves."""
    own = stacked.columns[true][0] @ rivals.effects[true].coefficients
    left = np.sqrt(noncentrality(rivals, stacked, true, rival))
    return float(left / max(float(np.linalg.norm(own)), 1e-300))
