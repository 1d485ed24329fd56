"""Rival effects on a fit, and the torque of one that the refit of another leaves."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import permutations, product

import numpy as np
from numpy.typing import NDArray

from lieid_casadi.compiled import Compiled, compile
from lieid_casadi.discrimination.stacked_columns import StackedColumns, span_basis
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
GRID = 25  # values of a shape parameter in a rival's refit; the square root for each of two
FINE_GRID = 81  # the same for the result
AT_REST = 2e-3  # relative to the velocity limit, below which friction is undetermined


@dataclass(frozen=True, eq=False)
class RivalEffect:
    """One effect with its assumed size.

    Attributes
    ----------
    placement : Placement
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
    """Rival effects, and the model that they have in common.

    Parameters
    ----------
    fit : Fit
    effects : sequence of str
        ``stribeck:1``, each on one joint.
    sizes : mapping
        Label → coefficients, optionally followed by shape parameters.
    independent_rate : (n,)
        Independent samples per second of each joint's residual.
    duration : float
        Of one period, s.
    velocity : (n,)
        Velocity limits, rad/s.
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
            raise EffectError(f"size of {unknown[0]}: not one of the rival effects")
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
        coefficients, shapes = self._fitted(self.common.placements)
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
            numbers = np.concatenate(self._fitted([placement]))
        model = Model.of_placements(self.common.robot, (*self.common.placements, placement))
        own = numbers[count:]
        return RivalEffect(placement, compile(model), numbers[:count], own, _grid(placement, own))

    def _fitted(self, placements: Sequence[Placement]) -> tuple[Array, Array]:
        """Return the coefficients and the shape parameters that the fit has for placements."""
        coefficients: dict[str, Array] = {}
        shapes: dict[str, Array] = {}
        c = s = 0
        for p in self.fit.model.placements:
            last_c, last_s = c + len(p.effect.coefficients), s + len(p.effect.shapes)
            coefficients[p.label] = self.fit.effect_coefficients[c:last_c]
            shapes[p.label] = self.fit.shapes[s:last_s]
            c, s = last_c, last_s
        empty = np.zeros(0)
        return (
            np.concatenate([empty, *(coefficients[p.label] for p in placements)]),
            np.concatenate([empty, *(shapes[p.label] for p in placements)]),
        )


def rival_placements(effects: Sequence[str], n: int) -> list[Placement]:
    """Return the placements of rival effects.

    Raises
    ------
    EffectError
        Fewer than two, one given twice, an unknown one, one on several joints, or one that needs
        a temperature.
    """
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
