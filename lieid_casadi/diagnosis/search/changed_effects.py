"""The search problem of changes: the model is kept, and a new recording is explained by additions.

The fit's parameters may move within their uncertainties (rows of a prior in addition to the
measured rows), so that an uncertain parameter is not taken for a change.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from lieid_casadi.diagnosis.residual.unexplained import Unexplained
from lieid_casadi.diagnosis.screening.baseline import Baseline, with_groups
from lieid_casadi.diagnosis.screening.candidate_columns import CandidateColumns
from lieid_casadi.diagnosis.screening.candidates import Candidate
from lieid_casadi.diagnosis.screening.context import ScreeningContext
from lieid_casadi.diagnosis.screening.cross_validation import cross_validated_gain
from lieid_casadi.diagnosis.search.effect_search import unexplained_parts
from lieid_casadi.diagnosis.search.parameter_checks import is_unresolved, unresolved_text
from lieid_casadi.diagnosis.search.search_problem import Offer, SearchProblem
from lieid_casadi.diagnosis.search.search_results import (
    AcceptedEffect,
    RejectedEffect,
    parameter_units,
)
from lieid_casadi.effects import ArmEffect, Placement
from lieid_casadi.identification.uncertainty.noise_model import Noise

Array = NDArray[np.float64]
#: Relative to the largest variance: below it a parameter counts as exactly known.
LEAST_VARIANCE = 1e-12
#: Part of a unit column outside the model's span, below which its coefficient is not fitted.
LEAST_OWN_PART = 1e-6


class ChangedEffects(SearchProblem):
    """Changes of an arm since a fit, on the rows of new recordings.

    Parameters
    ----------
    context : ScreeningContext
        With the model fixed.
    noise : tuple of Noise
        Of the fit's residual, with the standard deviation of held-out errors.
    seed : int

    Attributes
    ----------
    expected : (n,)
        Held-out error of the fit, N·m.
    """

    def __init__(self, context: ScreeningContext, noise: tuple[Noise, ...], *, seed: int) -> None:
        white = tuple(Noise.white(each.spread) for each in noise)
        super().__init__(
            context, noise, white, seed=seed, least_gain=context.options.least_change_improvement
        )
        self.expected = np.array([each.spread for each in noise])
        self.model = _with_prior(context, white)
        self._fixed_model = _without_columns(context, white)
        self._points: list[bytes] = []  # grid point of each accepted effect

    def baseline(self, noise: Sequence[Noise], candidates: CandidateColumns[Candidate]) -> Baseline:
        """Return the baseline of the model, within its uncertainty, and all accepted changes."""
        model = self.model if noise is self.white else _with_prior(self.context, noise)
        return with_groups(model, candidates, self._groups(candidates))

    def refined_grids(
        self,
        candidates: CandidateColumns[Candidate],
        baseline: Baseline,
        groups: Sequence[int],
        refined: set[str],
    ) -> Mapping[int, Array]:
        """Return finer grids around the selected groups.

        Columns of effects that are computed along a segment depend on the coefficients; these
        are evaluated again at the estimated coefficients.

        Parameters
        ----------
        candidates : CandidateColumns
            Whitened by the white noise.
        baseline : Baseline
        groups : sequence of int
            Selected on the present grids.
        refined : set of str
            Not used: grids are refined in every round.
        """
        grids = {}
        for g in groups:
            index, point = int(candidates.owner_index[g]), int(candidates.point[g])
            candidate = candidates.owners[index]
            if candidate.effect.shapes:
                finer = candidate.refined([point], self.options.refinement_positions)
                grids[index] = finer.grid
            elif isinstance(candidate.effect, ArmEffect):
                others = [other for other in groups if other != g]
                with_others = with_groups(baseline, candidates, others)
                values = with_others.coefficients(candidates.stacked(g), least=LEAST_OWN_PART)
                change = np.linalg.norm(values - candidate.grid[point])
                if change > self.options.coefficient_tolerance * np.linalg.norm(values):
                    grids[index] = np.vstack([candidate.grid, values])
        return grids

    def accept(self, offer: Offer) -> bool:
        """Accept a change that is significant, resolved, and reduces a raised error."""
        candidate, columns = offer.candidate, offer.columns
        before = self._misfit(self._accepted_columns(offer.candidates))
        after = self._misfit([*self._accepted_columns(offer.candidates), columns])
        fall = 1.0 - after / before
        joint = int(np.argmax(np.where(self.raised, fall, -np.inf)))
        held_out = cross_validated_gain(columns, offer.baseline, offer.context.folds(self.white))
        reason = self._unresolved(offer)
        if not reason and offer.significance.log10_p > np.log10(self.options.significance):
            reason = self.insignificant(offer.significance)
        least = self.options.least_change_improvement
        if not reason and (held_out <= 0.0 or not fall[joint] >= least):
            reason = f"the error of raised joints falls by only {100 * fall[joint]:.1f} %"
        if reason:
            return self.reject(candidate, reason)
        point = candidate.grid[offer.candidates.point[offer.group]]
        self.context = offer.context
        self._points.append(point.tobytes())
        parameters = _parameters(candidate, point, offer.baseline, columns)
        robot = self.context.fit.model.robot
        self.accepted.append(
            AcceptedEffect(
                candidate,
                parameters,
                parameter_units(robot, candidate.placement, parameters),
                self.expected * np.array([before, after]),
                joint,
                self.torque_rms(joint),
                offer.significance,
                offer.rivals,
            )
        )
        return True

    def update(self) -> None:
        """Do nothing: the model is not fitted again."""

    def is_finished(self) -> bool:
        """Whether no joint's error is raised."""
        return not self.raised.any()

    @property
    def raised(self) -> NDArray[np.bool_]:
        """Whether each joint's error is larger than on other motion (n,)."""
        rises = np.array([each.motion_ratio for each in self.coloured])
        misfit = self._misfit(self._accepted_columns(self.candidates(self.white)))
        return np.asarray(misfit > self.options.least_misfit * rises)

    def errors(self) -> Array:
        """Return the error of each joint (n,) with the accepted changes, N·m."""
        return self.expected * self._misfit(self._accepted_columns(self.candidates(self.white)))

    def remove(self, out: Sequence[Placement], reason: str) -> None:
        """Remove accepted changes."""
        labels = {placement.label for placement in out}
        pairs = list(zip(self.accepted, self._points, strict=True))
        kept = [(a, p) for a, p in pairs if a.candidate.placement.label not in labels]
        self.rejected += [
            RejectedEffect(a.candidate, reason)
            for a in self.accepted
            if a.candidate.placement.label in labels
        ]
        self.accepted, self._points = [a for a, _ in kept], [p for _, p in kept]

    def unexplained(self) -> tuple[Unexplained, ...]:
        """Return what smooth functions explain on the joints whose error is raised."""
        if not self.raised.any():
            return ()
        raised = self.raised
        return tuple(part for part in unexplained_parts(self) if raised[part.joint])

    def error_baselines(self) -> tuple[Baseline, Baseline]:
        """Return the residual of the fixed model, without and with the accepted changes."""
        candidates = self.candidates(self.white)
        last = with_groups(self._fixed_model, candidates, self._groups(candidates))
        return self._fixed_model, last

    def baseline_without(self, placement: Placement) -> Baseline:
        """Return the baseline of the model and of all accepted changes but one."""
        candidates = self.candidates(self.white)
        groups = [
            g for g in self._groups(candidates)
            if candidates.owner(g).placement.label != placement.label
        ]  # fmt: skip
        return with_groups(self.model, candidates, groups)

    def _groups(self, candidates: CandidateColumns[Candidate]) -> list[int]:
        """Return the groups of the accepted changes."""
        labels = [c.placement.label for c in candidates.owners]
        groups = []
        for effect, point in zip(self.accepted, self._points, strict=True):
            index = labels.index(effect.candidate.placement.label)
            grid = candidates.owners[index].grid
            (at,) = (k for k, row in enumerate(grid) if row.tobytes() == point)
            own = (candidates.owner_index == index) & (candidates.point == at)
            groups.append(int(np.flatnonzero(own)[0]))
        return groups

    def _accepted_columns(self, candidates: CandidateColumns[Candidate]) -> list[Array]:
        return [candidates.stacked(g) for g in self._groups(candidates)]

    def _misfit(self, columns: Sequence[Array]) -> Array:
        """Return each joint's error relative to the fit's held-out error (n,).

        The model's parameters do not move; only the columns (R, k) of changes are fitted.
        """
        kept = self._fixed_model
        for own in columns:
            kept = kept.with_columns(own)
        rows = [kept.residual[kept.joint(j)] for j in range(len(self.white))]
        return np.array([np.sqrt(np.mean(own**2)) if len(own) else 0.0 for own in rows])

    def _unresolved(self, offer: Offer) -> str:
        """Return which shape parameter is not resolved by the motion, or an empty text."""
        candidate = offer.candidate
        point = candidate.grid[offer.candidates.point[offer.group]]
        for shape, value in zip(candidate.effect.shapes, point, strict=False):
            if is_unresolved(shape, value, self.context.segments, candidate.joint, self.options):
                label = f"{candidate.name}.{shape.name}:{candidate.joint + 1}"
                return unresolved_text(label, float(value), shape.unit)
        return ""


def _parameters(
    candidate: Candidate, point: Array, baseline: Baseline, columns: Array
) -> dict[str, float]:
    """Return the coefficients of columns (R, k), and the shape parameters of a grid point."""
    values = baseline.coefficients(columns, least=LEAST_OWN_PART)
    effect = candidate.effect
    coefficients = {c.name: float(v) for c, v in zip(effect.coefficients, values, strict=True)}
    shapes = point[: len(effect.shapes)]
    return coefficients | {s.name: float(v) for s, v in zip(effect.shapes, shapes, strict=True)}


def _without_columns(context: ScreeningContext, noise: Sequence[Noise]) -> Baseline:
    """Return the residual of a model whose parameters cannot move."""
    residuals = context.whitened(noise, context.residual)
    ends = np.concatenate([[0], np.cumsum([len(r) for r in residuals])]).astype(np.intp)
    empty = np.zeros((ends[-1], 0))
    return Baseline(empty, empty, np.concatenate(residuals), ends)


def _with_prior(context: ScreeningContext, noise: Sequence[Noise]) -> Baseline:
    """Return the baseline of a model whose parameters may move within their uncertainty."""
    fit = context.fit
    count = len(fit.values) + len(fit.shapes)
    sizes, axes = np.linalg.eigh(fit.covariance[:count, :count])
    least = LEAST_VARIANCE * max(float(sizes.max(initial=0.0)), 1e-300)
    prior = (axes / np.sqrt(np.maximum(sizes, least))).T
    matrices = context.whitened(noise, context.model_columns)
    residuals = context.whitened(noise, context.residual)
    return Baseline.of([*matrices, prior], [*residuals, np.zeros(count)])
