"""Rival effects on a fit, and how well a motion separates them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import permutations, product

import numpy as np
from scipy.linalg import qr
from scipy.optimize import brentq
from scipy.stats import chi2, ncx2

from lieid_casadi.arrays import Array
from lieid_casadi.compiled import Compiled, compile
from lieid_casadi.discrimination.discrimination import ABSENCE, RivalPair
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
GRID = 25  # values of a shape parameter in a rival's refit; the square root for each of two
FINE_GRID = 81  # the same for the result
AT_REST = 2e-3  # relative to the velocity limit, below which friction is undetermined
ALIAS = 1e-6  # part of an effect below which no data can identify it; the diagnosis uses the same


@dataclass(frozen=True, eq=False)
class StackedColumns:
    """Columns along a motion, the rows of all joints stacked and weighted.

    The squared length of a vector is the noncentrality that one period contributes. ``common``
    (R, r) is an orthonormal basis of what all rivals share, ``columns`` (G, R, c) are those of each
    rival at the shape parameters of its grid.
    """

    common: Array
    columns: tuple[Array, ...]

    def outside_model(self, columns: Array) -> Array:
        """Return the part of columns (R, c) outside the common span."""
        for _ in range(2):  # against rounding
            columns = columns - self.common @ (self.common.T @ columns)
        return columns

    @cached_property
    def remaining_columns(self) -> tuple[tuple[Array, ...], ...]:
        """Columns of each rival outside the common span, at each point of its grid."""
        return tuple(tuple(self.outside_model(c) for c in each) for each in self.columns)

    def unexplained(self, true: int, rival: int | None, coefficients: Array) -> Array:
        """Return the weighted torque (R,) of one effect that the best refit of another leaves.

        None stands for its absence: the refit of the common model alone.
        """
        torque = self.remaining_columns[true][0] @ coefficients
        best: Array = torque
        if rival is None:
            return best
        for own in self.remaining_columns[rival]:
            basis = span_basis(own)
            left = torque - basis @ (basis.T @ torque)
            if left @ left < best @ best:
                best = left
        return best


def span_basis(columns: Array) -> Array:
    """Return an orthonormal basis of the span of columns (R, k), whatever their lengths."""
    scale = np.linalg.norm(columns, axis=0)
    basis, triangle, _ = qr(
        columns / np.where(scale > 0.0, scale, 1.0), mode="economic", pivoting=True
    )
    sizes = np.abs(np.diag(triangle))
    return np.asarray(basis[:, sizes > RANK_TOLERANCE * max(float(sizes.max(initial=0.0)), 1e-300)])


@dataclass(frozen=True, eq=False)
class RivalEffect:
    """One effect with its assumed size: coefficients (c,), NaN where unknown, and shapes (s,).

    ``compiled`` is the common model with this effect, whose columns are the last ones; ``grid``
    (G, s) has the shape parameters of its refit, ``shapes`` first.
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
    """A group of rival effects, and the model that they have in common.

    One effect alone is separated from its absence, the rival None.
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
        level: float,
    ) -> None:
        self.fit, self.duration, self.independent_rate = fit, duration, independent_rate
        self.level = level
        placements = rival_placements(effects, fit.model.n)
        labels = {p.label for p in placements}
        kept = [p for p in fit.model.placements if p.label not in labels]
        self.common = Model.of_placements(fit.model.robot, kept)
        self.compiled = compile(self.common)
        self._dead_zone = AT_REST * velocity
        self.effects = tuple(self._rival(p, sizes.get(p.label)) for p in placements)
        count = len(self.effects)
        self._pairs: list[tuple[int, int | None]] = [*permutations(range(count), 2)] or [(0, None)]
        self.needed: dict[tuple[int, int | None], float] = {}  # noncentrality, of separable pairs

    def columns_along(self, motion: MotionSamples) -> StackedColumns:
        """Return the columns of the common model and of all rivals along one period."""
        segment = self._segment(motion)
        weight = segment.moving * self._torque_weight() / np.sqrt(len(motion))
        coefficients, shapes = fitted_numbers(self.fit, self.common.placements)
        parameters = np.concatenate([self.fit.link_parameters, coefficients])
        effects = effects_along(self.compiled, segment, shapes, parameters)
        rigid = self.compiled.regressor(motion.q, motion.dq, motion.ddq)
        full = np.concatenate([rigid, effects], axis=2)[:, :, list(self.common.base.kept)]
        columns = []
        for rival in self.effects:
            own = np.nan_to_num(rival.coefficients)
            numbers = np.concatenate([parameters, own])
            each = [
                effects_along(rival.compiled, segment, np.concatenate([shapes, shape]), numbers)
                for shape in rival.grid
            ]
            columns.append(np.array([_flat(c[:, :, -len(own) :], weight) for c in each]))
        return StackedColumns(span_basis(_flat(full, weight)), tuple(columns))

    def prepare(self, motions: Sequence[MotionSamples]) -> None:
        """Assign sizes and find the pairs (true, rival) that some of the motions separate."""
        self._assign_sizes([self.columns_along(motion) for motion in motions])
        tried = [self.columns_along(motion) for motion in motions]
        for k, effect in enumerate(self.effects):
            if max(self._part_outside_model(stacked, k) for stacked in tried) < ALIAS:
                raise NoSolution(
                    f"{effect.label}: other parameters of the model absorb it along any motion, so "
                    "that no data can identify it. Leave it out, or fix the parameters that absorb "
                    "it"
                )
        for a, b in self._pairs:
            if max(self._remaining(stacked, a, b) for stacked in tried) >= ALIAS:
                self.needed[a, b] = noncentrality_needed(self.effects[a].parameters, self.level)
        for a, b in self._pairs:
            if b is not None and (a, b) not in self.needed and (b, a) not in self.needed:
                one, other = self.effects[a].label, self.effects[b].label
                raise NoSolution(
                    f"{one} and {other} of these sizes explain the same torque along any motion, "
                    "so that no data can separate them. Leave one of them out, or state other sizes"
                )

    def worst(self, motion: MotionSamples) -> float:
        """Return the smallest ratio, over the pairs, of noncentrality to the one needed.

        Its inverse is the number of periods after which the test separates all pairs.
        """
        stacked = self.columns_along(motion)
        return min(
            float(left @ left) / needed
            for pair, needed in self.needed.items()
            for left in [self._left(stacked, *pair)]
        )

    def result(self, motion: MotionSamples) -> list[RivalPair]:
        """Return how well a motion separates each pair.

        Grids of shape parameters are finer here: a search may have used the gaps of coarse ones.
        """
        self.effects = tuple(
            replace(r, grid=_grid(r.placement, r.shapes, FINE_GRID)) for r in self.effects
        )
        stacked, samples = self.columns_along(motion), len(motion)
        found = []
        for pair in self._pairs:
            true, other = (None if k is None else self.effects[k] for k in pair)
            assert true is not None
            left = self._left(stacked, *pair)
            found.append(
                RivalPair(
                    true=true.label, rival=ABSENCE if other is None else other.label,
                    noncentrality=float(left @ left),
                    needed=noncentrality_needed(true.parameters, self.level),
                    remaining=self._remaining(stacked, *pair), separable=pair in self.needed,
                    residual=left.reshape(samples, -1) * np.sqrt(samples) / self._torque_weight(),
                )
            )  # fmt: skip
        return found

    def _left(self, stacked: StackedColumns, true: int, rival: int | None) -> Array:
        """Return the weighted torque (R,) that is unexplained if the rival is fitted."""
        return stacked.unexplained(true, rival, self.effects[true].coefficients)

    def _remaining(self, stacked: StackedColumns, true: int, rival: int | None) -> float:
        """Return the part (0 to 1) of an effect's torque that the rival's refit leaves."""
        left = float(np.linalg.norm(self._left(stacked, true, rival)))
        return left / self._size(stacked, true)

    def _part_outside_model(self, stacked: StackedColumns, index: int) -> float:
        """Return the part (0 to 1) of an effect's torque that the common model does not span."""
        left = stacked.remaining_columns[index][0] @ self.effects[index].coefficients
        return float(np.linalg.norm(left)) / self._size(stacked, index)

    def _size(self, stacked: StackedColumns, index: int) -> float:
        own = stacked.columns[index][0] @ self.effects[index].coefficients
        return max(float(np.linalg.norm(own)), 1e-300)

    def _assign_sizes(self, tried: Sequence[StackedColumns]) -> None:
        """Assign sizes to effects that have none.

        Their RMS torque is that of the largest stated or fitted effect, or of the noise, in equal
        parts for each column, averaged over motions.
        """
        squares = [np.zeros(len(r.coefficients)) for r in self.effects]
        torques = np.zeros(len(self.effects))
        for stacked in tried:
            for k, (rival, columns) in enumerate(zip(self.effects, stacked.columns, strict=True)):
                squares[k] += (columns[0] ** 2).sum(axis=0) / len(tried)
                torques[k] += ((columns[0] @ rival.coefficients) ** 2).sum() / len(tried)
        available = torques[np.isfinite(torques)]
        made = []
        for rival, square in zip(self.effects, squares, strict=True):
            noise = self.independent_rate[rival.placement.joint] * self.duration
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

    def _torque_weight(self) -> Array:
        """Return the weight (n,) of a torque of 1 N·m per √sample of one period, 1/(N·m)."""
        return np.asarray(np.sqrt(self.independent_rate * self.duration) / self.fit.noise)

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
        numbers = np.array([np.nan] * count + [shape.initial for shape in effect.shapes])
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
        elif placement.label in {p.label for p in self.fit.model.placements}:
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
    if not found:
        raise EffectError("no effect; expected one, or several rivals")
    return found


def _grid(placement: Placement, own: Array, points: int = GRID) -> Array:
    """Return shape parameters (G, s): its own, the initial ones, and a grid over their ranges."""
    shapes = placement.effect.shapes
    if not any(shape.data is None for shape in shapes):
        return own[None]
    ranges = ShapeRange.of(shapes)
    count = max(3, round(points ** (1 / len(own))))
    places = product(np.linspace(0.0, 1.0, count), repeat=len(own))
    initial = [shape.initial for shape in shapes]
    return np.array([own, initial, *(ranges.shapes(np.array(p)) for p in places)])


def _flat(columns: Array, weight: Array) -> Array:
    """Return columns (N, n, k) as weighted rows (N n, k)."""
    return np.asarray((columns * weight[:, :, None]).reshape(-1, columns.shape[2]))


def noncentrality_needed(parameters: int, level: float) -> float:
    """Return the noncentrality at which χ² rejects at 1 − level with probability level."""
    threshold = chi2.ppf(level, parameters)
    return float(brentq(lambda x: ncx2.sf(threshold, parameters, x) - level, 1e-6, 1e3))
