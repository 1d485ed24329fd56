"""The search problem of missing effects: the model is fitted again with every accepted effect."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from lieid_casadi.diagnosis.screening.context import ScreeningContext
from lieid_casadi.diagnosis.screening.screen import SelectionState
from lieid_casadi.diagnosis.search.accepted_model import AcceptedModel
from lieid_casadi.diagnosis.search.better_rivals import better_rival
from lieid_casadi.diagnosis.search.candidate_selection import (
    at_estimate,
    grid_peaks,
    refined_shapes,
    with_possible_rivals,
)
from lieid_casadi.diagnosis.search.effect_search import search
from lieid_casadi.diagnosis.search.parameter_checks import (
    below_sample_time,
    implausible_sign,
    implausible_size,
)
from lieid_casadi.diagnosis.search.pruning import redundant_effects
from lieid_casadi.diagnosis.search.search_problem import Offer, logger
from lieid_casadi.diagnosis.search.search_results import (
    AcceptedEffect,
    Proposal,
    RejectedEffect,
    Replacement,
    fitted_parameters,
    parameter_units,
)
from lieid_casadi.diagnosis.search.successive_fits import Refit, start_near
from lieid_casadi.diagnosis.search.variants import better_variant
from lieid_casadi.diagnosis.search.worth import below_worth
from lieid_casadi.effects import Placement
from lieid_casadi.identification import Fit
from lieid_casadi.model import Model

Array = NDArray[np.float64]
#: Accepted effects, fit with them, screening context and rejected effects.
_State = tuple[list[AcceptedEffect], Fit, ScreeningContext, list[RejectedEffect]]
REDUNDANT = "no longer needed after a later effect was added"


class MissingEffects(AcceptedModel):
    """Effects that a model lacks.

    Parameters
    ----------
    first : ScreeningContext
        Of the fit before any effect is added, on the training recordings.
    refit : callable
    seed : int
    ask : callable, optional
        Called before each step is accepted; False rejects it.
    """

    def __init__(
        self,
        first: ScreeningContext,
        refit: Refit,
        *,
        seed: int,
        ask: Callable[[Proposal], bool] | None,
    ) -> None:
        super().__init__(first, refit, seed=seed)
        self.ask = ask
        self._tried: set[frozenset[str]] = set()  # labels of the models with a rival
        self._unexchanged: _State | None = None  # before rivals were exchanged

    def run(self, report: Callable[[str, float], None]) -> None:
        """Add effects until none is accepted, and exchange them for better variants."""
        search(self, self.options.most_steps, "most_steps", report)
        while self._exchange_variants():
            self.reconsider()
            search(self, self.options.most_steps, "most_steps", report)

    def refined_grids(
        self, state: SelectionState, groups: Sequence[int], refined: set[str]
    ) -> Mapping[int, Array]:
        """Return finer grids around the selected groups and the highest peaks, once per step.

        Columns that depend on their coefficients are evaluated at the estimates.

        Parameters
        ----------
        state : SelectionState
            Whitened by the white noise.
        groups : sequence of int
            Selected on the present grids.
        refined : set of str
            Labels of candidates refined in earlier rounds, which are left out.
        """
        if not groups:
            return {}
        candidates, options = state.candidates, self.options
        grids: dict[int, Array] = {}
        for g, others in with_possible_rivals(state, groups, options.least_rival_gain):
            if candidates.owner(g).placement.label not in refined:
                grid = at_estimate(state, g, others, options.coefficient_tolerance)
                if grid is not None:
                    grids.setdefault(int(candidates.owner_index[g]), grid)
        points: dict[int, list[int]] = {}
        for g in (*groups, *grid_peaks(candidates, state.given([]).gain, options.refined_gain)):
            candidate = candidates.owner(g)
            if candidate.effect.shapes and candidate.placement.label not in refined:
                points.setdefault(int(candidates.owner_index[g]), []).append(
                    int(candidates.point[g])
                )
        for k, at in points.items():
            grids[k] = candidates.owners[k].refined(at, options.refinement_positions).grid
        return grids

    def accept(self, offers: Sequence[Offer]) -> bool:
        """Accept effects that are significant, plausible, and reduce the held-out error."""
        passed = []
        for offer in offers:
            reason = (
                self.insignificant(offer.significance)
                or offer.held_out.reason
                or below_worth(offer.candidate, offer.held_out, self.white, self.options)
            )
            if reason:
                self.reject(offer.candidate, reason)
            elif not self._declined(offer):
                passed.append(offer)
        while passed:
            fit = self._with(passed)
            reasons = [self._implausible(offer.candidate.placement, fit) for offer in passed]
            if not any(reasons):
                self._add(passed, fit)
                return True
            for offer, reason in zip(passed, reasons, strict=True):
                if reason:
                    self.reject(offer.candidate, reason, final=True)
            passed = [o for o, reason in zip(passed, reasons, strict=True) if not reason]
        return False

    def _declined(self, offer: Offer) -> bool:
        """Ask before a step is accepted, if wanted; keep the answer no."""
        if self.ask is None:
            return False
        label, joint = offer.candidate.placement.label, offer.joint
        before, after = map(float, offer.errors[:, joint])
        if self.ask(Proposal(label, joint, before, after)):
            return False
        self.reject(offer.candidate, "declined by the user", final=True)
        return True

    def _with(self, offers: Sequence[Offer]) -> Fit:
        """Return the fit with further effects, their shape parameters from the refined grids."""
        shapes = [self.fit.shapes]
        for offer in offers:
            gain = offer.state.given(offer.others).gain
            shapes.append(refined_shapes(offer.state.candidates, gain, offer.group))
        placements = [offer.candidate.placement for offer in offers]
        larger = Model.of_placements(
            self.fit.model.robot, (*self.fit.model.placements, *placements)
        )
        start = start_near(self.fit, larger, np.concatenate(shapes), held=True)
        return self.refit(larger, start)

    def _add(self, offers: Sequence[Offer], fit: Fit) -> None:
        for offer in offers:
            placement, joint = offer.candidate.placement, offer.joint
            logger.info(
                "accepted %s: p = 1e%.0f, held-out error on joint %d falls by %.1f %%",
                placement.label, offer.significance.log10_p, joint + 1,
                100 * offer.held_out.fall[joint],
            )  # fmt: skip
            parameters = fitted_parameters(fit, placement)
            self.accepted.append(
                AcceptedEffect(
                    offer.candidate,
                    parameters,
                    parameter_units(fit.model.robot, placement, parameters),
                    offer.errors,
                    joint,
                    self.torque_rms(joint),
                    offer.significance,
                    offer.rivals,
                    fit,
                )
            )
        self.fit = fit

    def update(self) -> None:
        """Screen the last model, and remove the weakest effect that it no longer needs."""
        self.screen_again()
        last = self.accepted[-1].fit
        earlier = [a.candidate.placement for a in self.accepted if a.fit is not last]
        out = redundant_effects(self.context, self.white, earlier, self.options.worth)
        if out:
            self.remove(out[:1], REDUNDANT)

    def _exchange_variants(self) -> bool:
        """Exchange accepted effects for variants that hold better; whether there were any."""
        found = [better_variant(self, effect) for effect in self.accepted]
        variants = [variant for variant in found if variant is not None]
        if variants:
            self._exchange(variants)
        return bool(variants)

    def exchange_rival(self) -> bool:
        """Exchange an accepted effect for a better rival; whether there was one.

        The rival must pass all tests in the model fitted with it, and so must the other effects.
        """
        for effect in list(self.accepted):
            rival = better_rival(self, effect, self._tried)
            if rival is None:
                continue
            place = rival.candidate.placement
            labels = frozenset(p.label for p in self.placements)
            replaced = labels - {effect.candidate.placement.label} | {place.label}
            self._tried |= {labels, replaced}
            before = self._state()
            self._exchange([rival], final=False)
            implausible = self._implausible(place, self.fit)
            if not implausible and not any(self.in_last_model(a)[1] for a in self.accepted):
                self._unexchanged = self._unexchanged or before
                return True
            self._return_to(before)
            if implausible:
                self.reject(rival.candidate, implausible, final=True)
        return False

    def fit_shapes(self) -> None:
        """Fit all shape parameters together; return to the former effects if a rival fails then."""
        before, count = self._unexchanged, len(self.accepted)
        self._unexchanged = None
        super().fit_shapes()
        if before is not None and len(self.accepted) < count:
            self._return_to(before)
            super().fit_shapes()

    def _state(self) -> _State:
        return self.accepted, self.fit, self.context, list(self.rejected)

    def _return_to(self, state: _State) -> None:
        self.accepted, self.fit, self.context, self.rejected = state

    def _exchange(self, replacements: Sequence[Replacement], *, final: bool = True) -> None:
        """Replace accepted effects, and fit the model again from the first of them on.

        Parameters
        ----------
        replacements : sequence of Replacement
        final : bool
            Whether the effects stay rejected, as variants do; otherwise they are rivals.
        """
        changed, starts = set(), dict[str, float]()
        for new in replacements:
            effect, placement = new.effect, new.candidate.placement
            self.reject(effect.candidate, new.reason, final=final)
            own = Model.of_placements(self.fit.model.robot, (placement,))
            names = [p.name.rpartition(".")[2] for p in (*own.columns, *own.shapes)]
            units = parameter_units(self.fit.model.robot, placement, names)
            accepted = replace(effect, candidate=new.candidate, units=units, rivals=())
            self.accepted = [accepted if a is effect else a for a in self.accepted]
            changed.add(effect.fit)
            starts |= {p.label: float(x) for p, x in zip(own.shapes, new.shapes, strict=True)}
        self.fit_again(changed, starts=starts)

    def _implausible(self, placement: Placement, fit: Fit) -> str:
        """Return which parameter of an effect is physically implausible, or an empty text."""
        parameters = fitted_parameters(fit, placement)
        return (
            implausible_sign(fit, placement)
            or implausible_size(placement.effect, parameters)
            or below_sample_time(placement.effect, parameters, self.segments, self.options)
        )
