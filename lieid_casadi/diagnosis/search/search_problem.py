"""What the stepwise search needs of a problem: candidates, a baseline, and acceptance."""

from __future__ import annotations

import logging
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lieid_casadi.diagnosis.screening.baseline import Baseline
from lieid_casadi.diagnosis.screening.candidate_columns import CandidateColumns
from lieid_casadi.diagnosis.screening.candidates import Candidate
from lieid_casadi.diagnosis.screening.context import ScreeningContext
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
    candidates : CandidateColumns
        Of the context, whitened by the problem's white noise.
    baseline : Baseline
        Of the model and of all accepted effects, whitened alike.
    group : int
        Of the candidate, at its grid point.
    others : tuple of int
        Groups that were selected together with it.
    significance : Significance
    rivals : tuple of (Candidate, str)
    """

    context: ScreeningContext
    candidates: CandidateColumns[Candidate]
    baseline: Baseline
    group: int
    others: tuple[int, ...]
    significance: Significance
    rivals: tuple[tuple[Candidate, str], ...]

    @property
    def candidate(self) -> Candidate:
        """The candidate."""
        return self.candidates.owner(self.group)

    @property
    def columns(self) -> Array:
        """Its columns (R, k), whitened."""
        return self.candidates.stacked(self.group)


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
        self,
        candidates: CandidateColumns[Candidate],
        baseline: Baseline,
        groups: Sequence[int],
        refined: set[str],
    ) -> Mapping[int, Array]:
        """Return finer grids around selected groups: candidate index → grid (G, s).

        Parameters
        ----------
        candidates : CandidateColumns
            Whitened by the white noise.
        baseline : Baseline
        groups : sequence of int
            Selected on the present grids.
        refined : set of str
            Labels of candidates refined in earlier rounds of this step.
        """

    @abstractmethod
    def accept(self, offer: Offer) -> bool:
        """Accept a candidate, or reject it with a reason."""

    @abstractmethod
    def error_baselines(self) -> tuple[Baseline, Baseline]:
        """Return the baselines that state the error before and after all accepted effects."""

    @abstractmethod
    def baseline_without(self, placement: Placement) -> Baseline:
        """Return the baseline of the model and of all accepted effects but one."""

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

    def torque_rms(self, joint: int) -> float:
        """Return the RMS of the measured torque on a joint, N·m."""
        return float(np.sqrt(np.mean(self.context.torque[joint] ** 2)))

    def reject(self, candidate: Candidate, reason: str) -> bool:
        """Keep the reason for which a candidate is rejected, and return False."""
        logger.info("rejected %s: %s", candidate.placement.label, reason)
        self.rejected.append(RejectedEffect(candidate, reason))
        return False

    def insignificant(self, significance: Significance) -> str:
        """Return the reason for which an effect counts as noise."""
        return (
            f"not significant: family-wise p = {10.0**significance.log10_p:.2g} "
            f"(limit {self.options.significance:g})"
        )

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
