"""The search problem of changes: the model is kept, and a new recording is explained by additions.

The fit's parameters may move within their uncertainties (rows of a prior in addition to the
measured rows), so that an uncertain parameter is not taken for a change.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from lieid_casadi.diagnosis.residual.unexplained import Unexplained
from lieid_casadi.diagnosis.screening.baseline import Baseline, with_groups
from lieid_casadi.diagnosis.screening.candidate_columns import CandidateColumns
from lieid_casadi.diagnosis.screening.candidates import Candidate
from lieid_casadi.diagnosis.screening.context import ScreeningContext
from lieid_casadi.diagnosis.search.effect_search import unexplained_parts
from lieid_casadi.diagnosis.search.fixed_model import (
    LEAST_OWN_PART,
    fixed_parameters,
    with_prior,
    without_columns,
)
from lieid_casadi.diagnosis.search.parameter_checks import (
    implausible_size,
    is_unresolved,
    unresolved_text,
)
from lieid_casadi.diagnosis.search.search_problem import Offer, SearchProblem, joint_of
from lieid_casadi.diagnosis.search.search_results import (
    AcceptedEffect,
    RejectedEffect,
    parameter_units,
)
from lieid_casadi.effects import ArmEffect, Placement
from lieid_casadi.identification.uncertainty.noise_model import Noise

Array = NDArray[np.float64]


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
        self.model = with_prior(context, white)
        self._fixed_model = without_columns(context, white)
        self._points: list[bytes] = []  # grid point of each accepted effect

    def baseline(self, noise: Sequence[Noise], candidates: CandidateColumns[Candidate]) -> Baseline:
        """Return the baseline of the model, within its uncertainty, and all accepted changes."""
        model = self.model if noise is self.white else with_prior(self.context, noise)
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

    def accept(self, offers: Sequence[Offer]) -> bool:
        """Accept changes that are significant, resolved, and reduce a raised error."""
        candidates = offers[0].state.candidates
        own = self._accepted_columns(candidates)
        before, passed = self._misfit(own), []
        raised = self.raised
        for offer in offers:
            after = self._misfit([*own, offer.columns])
            fall = 1.0 - after / before
            joint = int(np.argmax(np.where(raised, fall, -np.inf)))
            unresolved = self._unresolved(offer) or self._implausible(offer)
            reason = unresolved or self.insignificant(offer.significance) or offer.held_out.reason
            if not reason and not fall[joint] >= self.options.least_change_improvement:
                reason = f"the error of raised joints falls by only {100 * fall[joint]:.1f} %"
            if reason:
                self.reject(offer.candidate, reason, final=bool(unresolved))
            else:
                passed.append((offer, joint))
        self._add(passed, before)
        return bool(passed)

    def _add(self, passed: Sequence[tuple[Offer, int]], before: Array) -> None:
        """Accept offers, each with the joint where the error falls most.

        Parameters
        ----------
        passed : sequence of (Offer, int)
        before : (n,)
            Relative error of each joint without them.
        """
        for offer, joint in passed:
            candidate, columns, state = offer.candidate, offer.columns, offer.state
            with_others = state.with_groups([o.group for o, _ in passed if o is not offer])
            point = candidate.grid[state.candidates.point[offer.group]]
            parameters = fixed_parameters(candidate, point, with_others, columns)
            own = [*self._accepted_columns(state.candidates), columns]
            self.accepted.append(
                AcceptedEffect(
                    candidate,
                    parameters,
                    parameter_units(self.context.fit.model.robot, candidate.placement, parameters),
                    self.expected * np.array([before, self._misfit(own)]),
                    joint,
                    self.torque_rms(joint),
                    offer.significance,
                    offer.rivals,
                )
            )
            self._points.append(point.tobytes())
            self.context = offer.context

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
        """Return the error of each joint (n,) with the accepted changes, N·m; NaN at rest."""
        misfit = self._misfit(self._accepted_columns(self.candidates(self.white)))
        moved = [
            len(self._fixed_model.residual[self._fixed_model.joint(j)]) > 0
            for j in range(len(self.white))
        ]
        return np.where(moved, self.expected * misfit, np.nan)

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
        return tuple(part for part in unexplained_parts(self, self.coloured) if raised[part.joint])

    def error_baselines(self) -> tuple[Baseline, Baseline]:
        """Return the residual of the fixed model, without and with the accepted changes."""
        candidates = self.candidates(self.white)
        last = with_groups(self._fixed_model, candidates, self._groups(candidates))
        return self._fixed_model, last

    def baseline_without(
        self, placement: Placement, noise: Sequence[Noise] | None = None
    ) -> Baseline:
        """Return the baseline of the model and of all accepted changes but one.

        Parameters
        ----------
        placement : Placement
        noise : sequence of Noise, optional
            By default the white noise.
        """
        noise = noise or self.white
        candidates = self.candidates(noise)
        model = self.model if noise is self.white else with_prior(self.context, noise)
        return with_groups(model, candidates, self._groups(candidates, without=placement))

    def columns_of(self, placement: Placement, noise: Sequence[Noise]) -> Array:
        """Return the columns (R, k) of an accepted change, whitened.

        Parameters
        ----------
        placement : Placement
        noise : sequence of Noise
        """
        candidates = self.candidates(noise)
        (group,) = (
            g
            for g in self._groups(candidates)
            if candidates.owner(g).placement.label == placement.label
        )
        return candidates.stacked(group)

    def in_last_model(self, effect: AcceptedEffect) -> tuple[AcceptedEffect, str]:
        """Return a change with the errors without and with it, and why it fails."""
        placement, candidates = effect.candidate.placement, self.candidates(self.white)
        others = [candidates.stacked(g) for g in self._groups(candidates, without=placement)]
        columns = self.columns_of(placement, self.white)
        before, after = self._misfit(others), self._misfit([*others, columns])
        fall = 1.0 - after / before
        joint = joint_of(effect.candidate, fall)
        held_out = self.held_out_rows.errors(columns, self.baseline_without(placement))
        reason = held_out.reason
        if not reason and not fall[joint] >= self.options.least_change_improvement:
            reason = f"the error of raised joints falls by only {100 * fall[joint]:.1f} %"
        errors = self.expected * np.array([before, after])
        found = replace(effect, errors=errors, joint=joint, torque_rms=self.torque_rms(joint))
        return found, reason

    def _groups(
        self, candidates: CandidateColumns[Candidate], *, without: Placement | None = None
    ) -> list[int]:
        """Return the groups of the accepted changes, without one of them if stated."""
        labels = [c.placement.label for c in candidates.owners]
        groups = []
        for effect, point in zip(self.accepted, self._points, strict=True):
            if without is not None and effect.candidate.placement.label == without.label:
                continue
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

    def _implausible(self, offer: Offer) -> str:
        """Return which coefficient is larger than on any real arm, or an empty text."""
        state, candidate = offer.state, offer.candidate
        with_others = state.with_groups(offer.others)
        point = candidate.grid[state.candidates.point[offer.group]]
        parameters = fixed_parameters(candidate, point, with_others, offer.columns)
        return implausible_size(candidate.effect, parameters)

    def _unresolved(self, offer: Offer) -> str:
        """Return which shape parameter is not resolved by the motion, or an empty text."""
        candidate = offer.candidate
        point = candidate.grid[offer.state.candidates.point[offer.group]]
        for shape, value in zip(candidate.effect.shapes, point, strict=False):
            if is_unresolved(shape, value, self.context.segments, candidate.joint, self.options):
                label = f"{candidate.name}.{shape.name}:{candidate.joint + 1}"
                return unresolved_text(label, float(value), shape.unit)
        return ""
