"""Candidates that the model's own columns span, completely or nearly."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from lieid_casadi.diagnosis.options import ABSORBED
from lieid_casadi.diagnosis.screening.baseline import Baseline
from lieid_casadi.diagnosis.screening.candidate_columns import CandidateColumns
from lieid_casadi.diagnosis.screening.candidates import Candidate
from lieid_casadi.diagnosis.screening.screen import screen
from lieid_casadi.identification.fit_warnings import WEAK


@dataclass(frozen=True)
class Aliases:
    """Candidates that cannot, or can hardly, be identified in addition to the model.

    Attributes
    ----------
    absorbed : tuple of str
        Labels of candidates whose columns the model spans: no recording can identify them.
    weak : tuple of (str, float)
        Labels, and the part of their columns (0 to 1) outside the model's span.
    """

    absorbed: tuple[str, ...]
    weak: tuple[tuple[str, float], ...]

    @property
    def sentence(self) -> str:
        """Which effects this diagnosis cannot name."""
        parts = []
        if self.absorbed:
            parts.append(
                "Not identifiable from any recording, because parameters of the model have the "
                f"same effect: {', '.join(self.absorbed)}."
            )
        if self.weak:
            named = ", ".join(f"{label} ({100 * part:.1f} %)" for label, part in self.weak)
            parts.append(
                "Hardly identifiable from these recordings (part of the effect that differs from "
                f"the model): {named}."
            )
        return " ".join(parts)


def aliases(candidates: CandidateColumns[Candidate], baseline: Baseline) -> Aliases:
    """Return the candidates that the baseline spans, completely or nearly, at their best shape."""
    remaining = np.zeros(len(candidates.owners))
    screening = screen(candidates, baseline, None)
    np.maximum.at(remaining, candidates.owner_index, screening.remaining)
    parts = [
        (c.placement.label, float(r)) for c, r in zip(candidates.owners, remaining, strict=True)
    ]
    return Aliases(
        tuple(label for label, part in parts if part < ABSORBED),
        tuple((label, part) for label, part in parts if ABSORBED <= part < WEAK),
    )
