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
from lieid_casadi.diagnosis.screening.screen import SelectionState
from lieid_casadi.diagnosis.search.candidate_selection import at_estimate, with_possible_rivals
from lieid_casadi.diagnosis.search.effect_search import unexplained_parts
from lieid_casadi.diagnosis.search.fixed_model import (
    fixed_parameters,
    implausible_offer,
    relative_fall,
    rms_by_joint,
    unconfirmed,
    with_prior,
    without_columns,
)
from lieid_casadi.diagnosis.search.search_problem import Offer, SearchProblem, joint_of
from lieid_casadi.diagnosis.search.search_results import (
    AcceptedEffect,
    RejectedEffect,
    parameter_units,
)
from lieid_casadi.diagnosis.wording import small_fall
from lieid_casadi.effects import Placement
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
        self, state: SelectionState, groups: Sequence[int], refined: set[str]
    ) -> Mapping[int, Array]:
        """Return finer grids around the selected groups and those that could take their places.

        Rivals are compared at their own best values: between two grid points a delay resembles
        a filter.

        Parameters
        ----------
        state : SelectionState
            Whitened by the white noise.
        groups : sequence of int
            Selected on the present grids.
        refined : set of str
            Not used: grids are refined in every round.
        """
        options, candidates, grids = self.options, state.candidates, dict[int, Array]()
        for g, others in with_possible_rivals(state, groups, options.least_rival_gain):
            candidate, point = candidates.owner(g), int(candidates.point[g])
            if candidate.effect.shapes:
                grid = candidate.refined([point], options.refinement_positions).grid
            else:
                grid = at_estimate(state, g, others, options.coefficient_tolerance)
            if grid is not None:
                grids.setdefault(int(candidates.owner_index[g]), grid)
        return grids

    def accept(self, offers: Sequence[Offer]) -> bool:
        """Accept changes that are significant, resolved, and reduce a raised error."""
        candidates = offers[0].state.candidates
        before = self._misfit(self._accepted_columns(candidates))
        raised, passed = self.raised, []
        for offer in offers:
            fall = relative_fall(offer.state.baseline, offer.columns, len(self.white))
            joint = int(np.argmax(np.where(raised, fall, -np.inf)))
            unresolved = implausible_offer(offer, self.context.segments, self.options)
            reason = unresolved or self.insignificant(offer.significance)
            alone = self._is_alone(offer.candidate)
            reason = reason or unconfirmed(offer.held_out, alone=alone)
            reason = reason or self._small(float(fall[joint]))
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

    def errors_beyond_uncertainty(self) -> Array:
        """Return the error of each joint (n,) with the accepted changes, N·m; 0 without rows.

        Without the part that the uncertainty of the fit's parameters explains.
        """
        return self.expected * rms_by_joint(self.current_baseline(self.white), len(self.white))

    def errors(self) -> Array:
        """Return the error of each joint (n,) with the accepted changes, N·m; NaN at rest."""
        misfit = self._misfit(self._accepted_columns(self.candidates(self.white)))
        rows = np.diff(self._fixed_model.ends)[: len(self.white)]
        return np.where(rows > 0, self.expected * misfit, np.nan)

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
        raised = self.raised
        parts = unexplained_parts(self, self.coloured) if raised.any() else ()
        return tuple(part for part in parts if raised[part.joint])

    def error_baselines(self) -> tuple[Baseline, Baseline]:
        """Return the residual of the fixed model, without and with the accepted changes."""
        own = self.candidates(self.white)
        return self._fixed_model, with_groups(self._fixed_model, own, self._groups(own))

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
        at = [a.candidate.placement.label for a in self.accepted].index(placement.label)
        return candidates.stacked(self._groups(candidates)[at])

    def in_last_model(self, effect: AcceptedEffect) -> tuple[AcceptedEffect, str]:
        """Return a change with its coefficients and errors beside the others, and why it fails."""
        placement, candidates = effect.candidate.placement, self.candidates(self.white)
        at = [a.candidate.placement.label for a in self.accepted].index(placement.label)
        group = self._groups(candidates)[at]
        owner = candidates.owner(group)
        point = owner.grid[candidates.point[group]]
        others = [candidates.stacked(g) for g in self._groups(candidates, without=placement)]
        columns = self.columns_of(placement, self.white)
        before, after = self._misfit(others), self._misfit([*others, columns])
        without = self.baseline_without(placement)
        fall = relative_fall(without, columns, len(self.white))
        joint = joint_of(effect.candidate, fall)
        held_out = self.held_out_rows.errors(columns, without)
        found = replace(
            effect,
            parameters=fixed_parameters(owner, point, without, columns),
            errors=self.expected * np.array([before, after]),
            joint=joint,
            torque_rms=self.torque_rms(joint),
        )
        reason = unconfirmed(held_out, alone=self._is_alone(effect.candidate))
        return found, reason or self._small(float(fall[joint]))

    def _is_alone(self, candidate: Candidate) -> bool:
        """Whether no other accepted change acts on the one joint of a candidate."""
        label = candidate.placement.label
        others = [a.candidate for a in self.accepted if a.candidate.placement.label != label]
        same = [c for c in others if c.joint == candidate.joint and not c.reaches_all]
        return candidate.reaches_all or not same

    def _small(self, fall: float) -> str:
        """Return why a relative fall of the error is too small, or an empty text."""
        small = fall < self.options.least_change_improvement
        return f"the error of raised joints {small_fall(fall)}" if small else ""

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
        return rms_by_joint(kept, len(self.white))
