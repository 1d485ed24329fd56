"""What the stepwise search needs of a problem: candidates, a baseline, and acceptance."""

from __future__ import annotations

import logging
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from lieid_casadi.diagnosis.residual.unexplained import Unexplained
from lieid_casadi.diagnosis.screening.baseline import Baseline
from lieid_casadi.diagnosis.screening.candidate_columns import CandidateColumns
from lieid_casadi.diagnosis.screening.candidates import Candidate
from lieid_casadi.diagnosis.screening.context import ScreeningContext
from lieid_casadi.diagnosis.screening.held_out import HeldOut, HeldOutRows
from lieid_casadi.diagnosis.screening.screen import SelectionState
from lieid_casadi.diagnosis.search.search_results import (
    AcceptedEffect,
    RejectedEffect,
    Significance,
)
from lieid_casadi.effects import Placement
from lieid_casadi.identification.uncertainty.noise_model import Noise

Array = NDArray[np.float64]
logger = logging.getLogger("lieid_casadi")


@dataclass(frozen=True, eq=False)
class Offer:
    """A candidate that is offered to a problem for acceptance.

    Attributes
    ----------
    context : ScreeningContext
        With the grids on which the candidate was selected.
    state : SelectionState
        Of its candidates and of the model with all accepted effects.
    group : int
        Of the candidate, at its grid point.
    others : tuple of int
        Groups that were selected together with it.
    significance : Significance
    rivals : tuple of (Candidate, str)
    held_out : HeldOut
        Held-out errors of the model with the others, without and with the candidate.
    """

    context: ScreeningContext
    state: SelectionState
    group: int
    others: tuple[int, ...]
    significance: Significance
    rivals: tuple[tuple[Candidate, str], ...]
    held_out: HeldOut

    @property
    def candidate(self) -> Candidate:
        """The candidate."""
        owner: Candidate = self.state.candidates.owner(self.group)
        return owner

    @property
    def columns(self) -> Array:
        """Its columns (R, k), whitened."""
        return self.state.candidates.stacked(self.group)

    @property
    def errors(self) -> Array:
        """Held-out errors (2, n) without and with the candidate, N·m."""
        return np.array([self.held_out.before, self.held_out.after])

    @property
    def joint(self) -> int:
        """The joint (from 0) where it counts; see `joint_of`."""
        return joint_of(self.candidate, self.held_out.fall)


def joint_of(candidate: Candidate, fall: Array) -> int:
    """Return the joint (from 0) where a candidate counts.

    Parameters
    ----------
    candidate : Candidate
        On a single joint it counts there, otherwise where the error falls most.
    fall : (n,)
        Relative fall of the error.
    """
    if candidate.joints and not candidate.reaches_all:
        return candidate.joint
    return int(np.argmax(fall))


class SearchProblem(ABC):
    """What a search needs: candidates, a baseline, and a test for acceptance.

    Parameters
    ----------
    context : ScreeningContext
    coloured : tuple of Noise
        Autoregressive noise of each joint, for p-values.
    white : tuple of Noise
        White noise of each joint, for the selection.
    seed : int
        Of the bootstrap.
    least_gain : float
        Least gain of an effect as a part of the rows of its joint.

    Attributes
    ----------
    accepted : list of AcceptedEffect
    rejected : list of RejectedEffect
    limits_reached : list of str
        Names of the options whose limit ended the search.
    """

    def __init__(
        self,
        context: ScreeningContext,
        coloured: tuple[Noise, ...],
        white: tuple[Noise, ...],
        *,
        seed: int,
        least_gain: float,
    ) -> None:
        self.context, self.coloured, self.white = context, coloured, white
        self.options, self.seed, self.least_gain = context.options, seed, least_gain
        self.accepted: list[AcceptedEffect] = []
        self.rejected: list[RejectedEffect] = []
        self.limits_reached: list[str] = []
        self._white_candidates: tuple[ScreeningContext, CandidateColumns[Candidate]] | None = None

    @abstractmethod
    def baseline(self, noise: Sequence[Noise], candidates: CandidateColumns[Candidate]) -> Baseline:
        """Return the baseline of the model and of all accepted effects.

        Parameters
        ----------
        noise : sequence of Noise
        candidates : CandidateColumns
            Of the current grids, whitened by ``noise``.
        """

    @abstractmethod
    def refined_grids(
        self, state: SelectionState, groups: Sequence[int], refined: set[str]
    ) -> Mapping[int, Array]:
        """Return finer grids around selected groups and their rivals: candidate → grid (G, s).

        Parameters
        ----------
        state : SelectionState
            Whitened by the white noise.
        groups : sequence of int
            Selected on the present grids.
        refined : set of str
            Labels of candidates refined in earlier rounds of this step.
        """

    @abstractmethod
    def accept(self, offers: Sequence[Offer]) -> bool:
        """Accept members of a family, reject the others with a reason; whether any is accepted."""

    @abstractmethod
    def error_baselines(self) -> tuple[Baseline, Baseline]:
        """Return the baselines that state the error before and after all accepted effects."""

    @abstractmethod
    def baseline_without(
        self, placement: Placement, noise: Sequence[Noise] | None = None
    ) -> Baseline:
        """Return the baseline of the model and of all accepted effects but one.

        Parameters
        ----------
        placement : Placement
        noise : sequence of Noise, optional
            By default the white noise.
        """

    @abstractmethod
    def columns_of(self, placement: Placement, noise: Sequence[Noise]) -> Array:
        """Return the columns (R, k) of an accepted effect in the last model, whitened.

        Parameters
        ----------
        placement : Placement
        noise : sequence of Noise
        """

    @abstractmethod
    def in_last_model(self, effect: AcceptedEffect) -> tuple[AcceptedEffect, str]:
        """Return an accepted effect with its errors in the last model, and why it fails there.

        The errors are those of the last model without the effect, and with it.
        """

    @abstractmethod
    def unexplained(self) -> tuple[Unexplained, ...]:
        """Return what smooth functions explain of the residual of all accepted effects."""

    @abstractmethod
    def remove(self, out: Sequence[Placement], reason: str) -> None:
        """Remove accepted effects, and keep the reason."""

    @property
    def refitted(self) -> bool:
        """Whether the model is fitted again with every accepted effect."""
        return False

    def exchange_rival(self) -> bool:
        """Exchange an accepted effect for a better rival; whether there was one.

        Changes of a model that is kept are not exchanged.
        """
        return False

    def fit_shapes(self) -> None:
        """Fit all shape parameters together; those of changes of a kept model stay as they are."""
        return

    def last_noise(self) -> tuple[Noise, ...]:
        """Return the autoregressive noise of each joint, estimated in the last model."""
        return self.coloured

    def is_finished(self) -> bool:
        """Whether the error is too small for a further step."""
        return False

    @abstractmethod
    def update(self) -> None:
        """Prepare the next step after an effect was accepted."""

    def excluded(self, candidates: CandidateColumns[Candidate]) -> NDArray[np.bool_]:
        """Mark the candidates that are rejected or accepted already."""
        labels = {r.candidate.placement.label for r in self.rejected}
        labels |= {a.candidate.placement.label for a in self.accepted}
        return np.array([c.placement.label in labels for c in candidates.owners], dtype=bool)

    def is_excluded(self, candidate: Candidate) -> bool:
        """Whether a candidate was rejected for good."""
        label = candidate.placement.label
        return any(r.final and r.candidate.placement.label == label for r in self.rejected)

    def torque_rms(self, joint: int) -> float:
        """Return the RMS of the measured torque on a joint, N·m."""
        return float(np.sqrt(np.mean(self.context.torque[joint] ** 2)))

    def reject(self, candidate: Candidate, reason: str, *, final: bool = False) -> None:
        """Keep the reason for which a candidate is rejected.

        Parameters
        ----------
        candidate : Candidate
        reason : str
        final : bool
            Whether it is never tried again; otherwise it is after the next acceptance.
        """
        logger.info("rejected %s: %s", candidate.placement.label, reason)
        self.rejected.append(RejectedEffect(candidate, reason, final))

    def reconsider(self) -> None:
        """Let candidates that failed a statistical test be tried again."""
        self.rejected = [r for r in self.rejected if r.final]

    def insignificant(self, significance: Significance) -> str:
        """Return the reason for which an effect counts as noise; empty if it does not."""
        if significance.log10_p <= np.log10(self.options.significance):
            return ""
        return (
            f"not significant: family-wise p = {10.0**significance.log10_p:.2g} "
            f"(limit {self.options.significance:g})"
        )

    @cached_property
    def held_out_rows(self) -> HeldOutRows:
        """The held-out parts; all contexts of a problem have the same rows."""
        return self.context.held_out_rows(self.white, self.coloured)

    def candidates(self, noise: Sequence[Noise]) -> CandidateColumns[Candidate]:
        """Return the columns of all candidates, whitened; those for the white noise are kept."""
        context = self.context
        if noise is not self.white:
            return context.candidates.whitened(noise, context.runs)
        if self._white_candidates is None or self._white_candidates[0] is not context:
            columns = context.candidates.whitened(noise, context.runs)
            self._white_candidates = context, columns
        return self._white_candidates[1]

    def current_baseline(self, noise: Sequence[Noise]) -> Baseline:
        """Return the baseline of the model and of all accepted effects."""
        return self.baseline(noise, self.candidates(noise))
