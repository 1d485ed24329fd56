"""The model with all accepted effects: fitted again, screened again, and without each of them."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from lieid_casadi.diagnosis.residual.unexplained import Unexplained
from lieid_casadi.diagnosis.screening.baseline import Baseline
from lieid_casadi.diagnosis.screening.candidate_columns import CandidateColumns
from lieid_casadi.diagnosis.screening.candidates import Candidate
from lieid_casadi.diagnosis.screening.context import ScreeningContext
from lieid_casadi.diagnosis.search.effect_search import unexplained_parts
from lieid_casadi.diagnosis.search.parameter_checks import implausible_sign, unresolved_shape
from lieid_casadi.diagnosis.search.pilot_noise import final_noise, pilot_noise
from lieid_casadi.diagnosis.search.pruning import baseline_without, columns_of
from lieid_casadi.diagnosis.search.search_problem import SearchProblem, joint_of
from lieid_casadi.diagnosis.search.search_results import AcceptedEffect, RejectedEffect, with_fit
from lieid_casadi.diagnosis.search.successive_fits import Refit, fitted_again, start_near
from lieid_casadi.diagnosis.search.worth import below_worth
from lieid_casadi.effects import Placement
from lieid_casadi.identification import Fit
from lieid_casadi.identification.uncertainty.noise_model import Noise

Array = NDArray[np.float64]


class AcceptedModel(SearchProblem):
    """A search problem whose model is fitted again with every accepted effect.

    Parameters
    ----------
    first : ScreeningContext
        Of the fit before any effect is added, on the training recordings.
    refit : callable
    seed : int

    Attributes
    ----------
    fit : Fit
        With all accepted effects.
    first : ScreeningContext
        Of the fit before any effect was added.
    """

    def __init__(self, first: ScreeningContext, refit: Refit, *, seed: int) -> None:
        self.fit, self.segments, self.first = first.fit, first.segments, first
        self.refit = refit
        coloured, white = pilot_noise(first)
        super().__init__(first, coloured, white, seed=seed, least_gain=first.options.worth)
        self._last_noise: tuple[ScreeningContext, tuple[Noise, ...]] | None = None

    def baseline(self, noise: Sequence[Noise], candidates: CandidateColumns[Candidate]) -> Baseline:
        """Return the baseline of the last model, which contains the accepted effects."""
        return self.context.baseline(noise)

    @property
    def refitted(self) -> bool:
        """Whether the model is fitted again with every accepted effect."""
        return True

    @property
    def placements(self) -> list[Placement]:
        """The accepted effects in the order added."""
        return [effect.candidate.placement for effect in self.accepted]

    def remove(self, out: Sequence[Placement], reason: str) -> None:
        """Remove accepted effects and fit the model again, from the first of them on."""
        labels = {placement.label for placement in out}
        removed = [a for a in self.accepted if a.candidate.placement.label in labels]
        self.rejected += [RejectedEffect(a.candidate, reason) for a in removed]
        self.fit_again({a.fit for a in removed}, out=labels)

    def fit_again(
        self,
        changed: Collection[Fit | None],
        *,
        out: Collection[str] = (),
        starts: Mapping[str, float] | None = None,
    ) -> None:
        """Fit the model again from the first changed fit on.

        Parameters
        ----------
        changed : collection of Fit
            Of accepted effects that were exchanged or are removed.
        out : collection of str
            Labels of accepted effects that are removed.
        starts : dict, optional
            Values of shape parameters, by label, that the last model does not have.
        """
        last_shapes = zip(self.fit.model.shapes, self.fit.shapes, strict=True)
        shapes = {p.label: float(x) for p, x in last_shapes} | dict(starts or {})
        kept = [a for a in self.accepted if a.candidate.placement.label not in out]
        order = list(dict.fromkeys(a.fit for a in self.accepted))
        self.accepted, self.fit = fitted_again(
            kept, order, changed, shapes, first=self.first.fit, refit=self.refit
        )
        self.screen_again()

    def fit_shapes(self) -> None:
        """Fit all shape parameters together; the steps have taken them from the grids."""
        if not self.accepted or not len(self.fit.shapes):
            return
        fit = self._fitted_again(held=False)
        for placement in self.placements:
            reason = implausible_sign(fit, placement) or unresolved_shape(
                fit, placement, self.segments, self.options
            )
            if reason:
                self.remove([placement], reason)
                self.fit_shapes()
                return
        self._replace_last(fit)
        self.screen_again()

    def complete(self) -> None:
        """Fit the last model with the uncertainty of its parameters."""
        if self.accepted and np.isnan(self.fit.covariance).any():
            self._replace_last(self._fitted_again(held=True))

    def _fitted_again(self, *, held: bool) -> Fit:
        """Return another fit of the last model, with the uncertainty of its parameters."""
        start = start_near(self.fit, self.fit.model, self.fit.shapes, held=held)
        return self.refit(self.fit.model, start, uncertainty=True)

    def _replace_last(self, fit: Fit) -> None:
        """Replace the last fit by another one of the same model."""
        last = self.accepted[-1].fit
        self.accepted = [with_fit(a, fit) if a.fit is last else a for a in self.accepted]
        self.fit = fit

    def screen_again(self) -> None:
        """Evaluate the columns of the last model and of the candidates that it lacks."""
        self.context = ScreeningContext.of(
            self.fit, self.segments, self.options, previous=self.context
        )

    def error_baselines(self) -> tuple[Baseline, Baseline]:
        """Return the baselines of the first and of the last model."""
        return self.first.baseline(self.white), self.context.baseline(self.white)

    def last_noise(self) -> tuple[Noise, ...]:
        """Return the autoregressive noise of each joint, estimated in the last model."""
        if self._last_noise is None or self._last_noise[0] is not self.context:
            self._last_noise = self.context, final_noise(self.context)
        return self._last_noise[1]

    def unexplained(self) -> tuple[Unexplained, ...]:
        """Return what smooth functions explain of the last model's residual."""
        return unexplained_parts(self, self.last_noise())

    def baseline_without(
        self, placement: Placement, noise: Sequence[Noise] | None = None
    ) -> Baseline:
        """Return the baseline of the last model without the columns of one effect.

        Parameters
        ----------
        placement : Placement
        noise : sequence of Noise, optional
            By default the white noise.
        """
        return baseline_without(self.context, noise or self.white, placement)

    def columns_of(self, placement: Placement, noise: Sequence[Noise]) -> Array:
        """Return the columns (R, k) of an effect's coefficients in the last model, whitened.

        Parameters
        ----------
        placement : Placement
        noise : sequence of Noise
        """
        linear = len(self.fit.model.base_columns)
        own = [k for k in columns_of(self.context, placement) if k < linear]
        matrices = [matrix[:, own] for matrix in self.context.model_columns]
        return np.concatenate(self.context.whitened(noise, matrices))

    def in_last_model(self, effect: AcceptedEffect) -> tuple[AcceptedEffect, str]:
        """Return an effect with its held-out errors in the last model, and why it fails there."""
        placement = effect.candidate.placement
        held_out = self.held_out_rows.errors(
            self.columns_of(placement, self.white),
            self.baseline_without(placement),
            blocks=placement.effect.per_recording,
        )
        joint = joint_of(effect.candidate, held_out.fall)
        errors = np.array([held_out.before, held_out.after])
        found = replace(effect, errors=errors, joint=joint, torque_rms=self.torque_rms(joint))
        small = below_worth(effect.candidate, held_out, self.white, self.options)
        return found, held_out.reason or small
