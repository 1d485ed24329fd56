"""Candidates that the model's own columns can take the place of, wholly or nearly."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from lieid_casadi.diagnosis.screening.candidate_columns import Bank
from lieid_casadi.diagnosis.screening.candidates import Candidate
from lieid_casadi.diagnosis.screening.screen import ABSORBED, Baseline, screen
from lieid_casadi.identification.fit_warnings import WEAK


@dataclass(frozen=True)
class Aliases:
    """Labels of candidates; ``weak`` with the part of their columns that remains."""

    absorbed: tuple[str, ...]
    weak: tuple[tuple[str, float], ...]

    @property
    def sentence(self) -> str:
        """What no diagnosis of these recordings can name, in words."""
        parts = []
        if self.absorbed:
            parts.append(f"No data can tell from the model: {', '.join(self.absorbed)}.")
        if self.weak:
            named = ", ".join(f"{label} ({100 * part:.1f} % its own)" for label, part in self.weak)
            parts.append(f"These recordings hardly tell from it: {named}.")
        return " ".join(parts)


def aliases(bank: Bank[Candidate], baseline: Baseline) -> Aliases:
    """Return what remains of no candidate's columns, or of little, at its best shape."""
    remaining = np.zeros(len(bank.candidates))
    np.maximum.at(remaining, bank.candidate, screen(bank, baseline).remaining)
    labels = [candidate.placement.label for candidate in bank.candidates]
    return Aliases(
        tuple(label for label, part in zip(labels, remaining, strict=True) if part < ABSORBED),
        tuple(
            (label, float(part))
            for label, part in zip(labels, remaining, strict=True)
            if ABSORBED <= part < WEAK
        ),
    )
