"""The search problem of missing effects: the model is fitted again with every accepted effect."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from lieid_casadi.diagnosis.options import DiagnosisOptions
from lieid_casadi.diagnosis.screening.baseline import Baseline, with_groups
from lieid_casadi.diagnosis.screening.candidate_columns import CandidateColumns
from lieid_casadi.diagnosis.screening.candidates import Candidate
from lieid_casadi.diagnosis.screening.context import ScreeningContext
from lieid_casadi.diagnosis.screening.screen import screen
from lieid_casadi.diagnosis.search.candidate_selection import grid_peaks, refined_shapes
from lieid_casadi.diagnosis.search.effect_search import search
from lieid_casadi.diagnosis.search.parameter_checks import (
    implausible_sign,
    unresolved_shape,
)
from lieid_casadi.diagnosis.search.pilot_noise import pilot_noise
from lieid_casadi.diagnosis.search.pruning import baseline_without, redundant_effects
from lieid_casadi.diagnosis.search.search_problem import Offer, SearchProblem, logger
from lieid_casadi.diagnosis.search.search_results import (
    AcceptedEffect,
    Proposal,
    RejectedEffect,
    fitted_parameters,
    parameter_units,
    with_fit,
)
from lieid_casadi.effects import Placement
from lieid_casadi.identification import Fit
from lieid_casadi.identification.regression.fixed_point import ShapeStart
from lieid_casadi.identification.uncertainty.noise_model import Noise
from lieid_casadi.model import Model
from lieid_casadi.recording import Processed

Array = NDArray[np.float64]
#: Fit of a model to the training recordings, from shape parameters.
Refit = Callable[[Model, ShapeStart | None], Fit]
#: Error of a fit on the test per joint (n,), N·m; NaN without a test.
TestError = Callable[[Fit], Array]
REDUNDANT = "no longer needed after a later effect was added"


class MissingEffects(SearchProblem):
    """Effects that a model lacks.

    Parameters
    ----------
    fit : Fit
        Of the model before any effect is added.
    segments : tuple of Processed
        The training recordings.
    refit : callable
    test_error : callable
    options : DiagnosisOptions
    seed : int
    ask : callable, optional
        Called before each step is accepted; False rejects it.

    Attributes
    ----------
    fit : Fit
        With all accepted effects.
    first : ScreeningContext
        Of the fit before any effect was added.
    """

    def __init__(
        self,
        fit: Fit,
        segments: tuple[Processed, ...],
        refit: Refit,
        test_error: TestError,
        *,
        options: DiagnosisOptions,
        seed: int,
        ask: Callable[[Proposal], bool] | None,
    ) -> None:
        self.fit, self.segments = fit, segments
        self.refit, self.test_error, self.ask = refit, test_error, ask
        self.first = ScreeningContext.of(fit, segments, options)
        coloured, white = pilot_noise(self.first)
        super().__init__(
            self.first, coloured, white, seed=seed, least_gain=options.least_improvement
        )
        self._white_baseline: Baseline | None = None

    def run(self, report: Callable[[float], None]) -> None:
        """Add effects until none is accepted, then fit all shape parameters together."""
        search(self, self.options.most_steps, "most_steps", report)
        self._fit_shapes()

    def baseline(self, noise: Sequence[Noise], candidates: CandidateColumns[Candidate]) -> Baseline:
        """Return the baseline of the last model, which contains the accepted effects."""
        if noise is not self.white:
            return self.context.baseline(noise)
        if self._white_baseline is None:
            self._white_baseline = self.context.baseline(noise)
        return self._white_baseline

    def refined_grids(
        self,
        candidates: CandidateColumns[Candidate],
        baseline: Baseline,
        groups: Sequence[int],
        refined: set[str],
    ) -> Mapping[int, Array]:
        """Return finer grids around the selected groups and the highest peaks, once per step.

        Parameters
        ----------
        candidates : CandidateColumns
            Whitened by the white noise.
        baseline : Baseline
        groups : sequence of int
            Selected on the present grids.
        refined : set of str
            Labels of candidates refined in earlier rounds, which are left out.
        """
        if not groups:
            return {}
        gain = screen(candidates, baseline, self.options).gain
        points: dict[int, list[int]] = {}
        for g in (*groups, *grid_peaks(candidates, gain, self.options.refined_gain)):
            candidate = candidates.owner(g)
            if candidate.effect.shapes and candidate.placement.label not in refined:
                points.setdefault(int(candidates.owner_index[g]), []).append(
                    int(candidates.point[g])
                )
        positions = self.options.refinement_positions
        return {k: candidates.owners[k].refined(at, positions).grid for k, at in points.items()}

    def accept(self, offer: Offer) -> bool:
        """Accept an effect that is significant, plausible, and reduces the held-out error."""
        candidate, placement = offer.candidate, offer.candidate.placement
        if offer.significance.log10_p > np.log10(self.options.significance):
            return self.reject(candidate, self.insignificant(offer.significance))
        with_others = with_groups(offer.baseline, offer.candidates, offer.others)
        gain = screen(offer.candidates, with_others, self.options).gain
        shapes = refined_shapes(offer.candidates, gain, offer.group)
        larger = Model.of_placements(self.fit.model.robot, (*self.fit.model.placements, placement))
        start = np.concatenate([self.fit.shapes, shapes])
        fit = self.refit(larger, ShapeStart(start, held=True))
        errors = np.array([self.fit.rms_cv, fit.rms_cv])
        joint = int(np.nanargmax(1.0 - errors[1] / errors[0]))
        confirmed = self._confirmed(fit, joint)
        reason = (
            implausible_sign(fit, placement)
            or self._small_improvement(candidate, errors)
            or ("the error on the test does not fall" if confirmed is False else "")
            or self._below_sample_time(placement, fit)
        )
        if reason:
            return self.reject(candidate, reason)
        before, after = map(float, errors[:, joint])
        if self.ask is not None and not self.ask(Proposal(placement.label, joint, before, after)):
            return self.reject(candidate, "declined by the user")
        logger.info(
            "accepted %s: p = 1e%.0f, error on joint %d falls by %.1f %%",
            placement.label, offer.significance.log10_p, joint + 1, 100 * (1.0 - after / before),
        )  # fmt: skip
        self.fit = fit
        parameters = fitted_parameters(fit, placement)
        self.accepted.append(
            AcceptedEffect(
                candidate,
                parameters,
                parameter_units(fit.model.robot, placement, parameters),
                errors,
                joint,
                self.torque_rms(joint),
                offer.significance,
                offer.rivals,
                confirmed,
                fit,
            )
        )
        return True

    def update(self) -> None:
        """Screen the last model, and remove the weakest effect that it no longer needs."""
        self._screen_again()
        out = redundant_effects(
            self.context, self.white, self.placements[:-1], self.options.least_improvement
        )
        if out:
            self.remove(out[:1], REDUNDANT)

    @property
    def placements(self) -> list[Placement]:
        """The accepted effects in the order added."""
        return [effect.candidate.placement for effect in self.accepted]

    def remove(self, out: Sequence[Placement], reason: str) -> None:
        """Remove accepted effects and fit the model again, step by step."""
        labels = {placement.label for placement in out}
        self.rejected += [
            RejectedEffect(a.candidate, reason)
            for a in self.accepted
            if a.candidate.placement.label in labels
        ]
        shapes = {
            p.label: float(x) for p, x in zip(self.fit.model.shapes, self.fit.shapes, strict=True)
        }
        kept = [a for a in self.accepted if a.candidate.placement.label not in labels]
        self.accepted = []
        model, self.fit = self.first.fit.model, self.first.fit
        for effect in kept:
            placement = effect.candidate.placement
            model = Model.of_placements(model.robot, (*model.placements, placement))
            held = np.array([shapes[p.label] for p in model.shapes])
            self.fit = self.refit(model, ShapeStart(held, held=True))
            self.accepted.append(with_fit(effect, self.fit))
        self._screen_again()

    def error_baselines(self) -> tuple[Baseline, Baseline]:
        """Return the baselines of the first and of the last model."""
        return self.first.baseline(self.white), self.context.baseline(self.white)

    def baseline_without(self, placement: Placement) -> Baseline:
        """Return the baseline of the last model without the columns of one effect."""
        return baseline_without(self.context, self.white, placement)

    def _screen_again(self) -> None:
        self.context = ScreeningContext.of(
            self.fit, self.segments, self.options, previous=self.context
        )
        self._white_baseline = None

    def _fit_shapes(self) -> None:
        """Fit all shape parameters together; the steps have taken them from the grids."""
        if not self.accepted or not len(self.fit.shapes):
            return
        fit = self.refit(self.fit.model, ShapeStart(self.fit.shapes))
        for placement in self.placements:
            reason = implausible_sign(fit, placement) or unresolved_shape(
                fit, placement, self.segments, self.options
            )
            if reason:
                self.remove([placement], reason)
                self._fit_shapes()
                return
        self.fit = fit
        self.accepted[-1] = with_fit(self.accepted[-1], fit)
        self._screen_again()

    def _small_improvement(self, candidate: Candidate, errors: Array) -> str:
        """Return why the fall of the held-out errors (2, n) is too small, or an empty text."""
        fall = float(np.nanmax(1.0 - errors[1] / errors[0]))
        if fall < self.options.least_improvement:
            return f"the held-out error falls by only {100 * fall:.1f} %"
        on_all = 1.0 - self._mean_square(errors[1]) / self._mean_square(errors[0])
        if candidate.reaches_all and on_all < self.options.least_improvement_all_joints:
            return f"the mean square error of all joints falls by only {100 * on_all:.1f} %"
        return ""

    def _mean_square(self, errors: Array) -> float:
        """Return the mean square of errors (n,) relative to the joints' noise."""
        return float(
            np.nanmean([(e / n.spread) ** 2 for e, n in zip(errors, self.white, strict=True)])
        )

    def _confirmed(self, fit: Fit, joint: int) -> bool | None:
        """Whether the test's error falls on a joint, and the mean square error of all joints."""
        before, after = self.test_error(self.fit), self.test_error(fit)
        if np.isnan(after[joint]):
            return None
        falls = after[joint] < before[joint]
        return bool(falls and self._mean_square(after) < self._mean_square(before))

    def _below_sample_time(self, placement: Placement, fit: Fit) -> str:
        """Return which coefficient is too small for the sampling rate, or an empty text."""
        rate = min(segment.recording.rate for segment in self.segments)
        parameters = fitted_parameters(fit, placement)
        for coefficient in placement.effect.coefficients:
            if coefficient.resolved_by != "sample_time":
                continue
            value = parameters[coefficient.name]
            if abs(value) * rate < self.options.least_delay_samples:
                return (
                    f"{coefficient.name} = {value:.2g} {coefficient.unit} is less than one sample; "
                    "differentiating the position shifts the velocity by as much"
                )
        return ""
