"""What a check of the premises found."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

from lieid_casadi.arrays import Array
from lieid_casadi.tables import Table, figures, html, make_table

Verdict = Literal["sound", "doubtful", "wrong"]


@dataclass(frozen=True)
class Finding:
    """A premise that the recording contradicts."""

    premise: str  # name, such as gravity_direction
    joints: tuple[int, ...]  # from 0; at most three
    value: Mapping[str, Any]  # its keys depend on the premise
    sentence: str
    remedy: str  # the option or edit that corrects it
    certain: bool = False  # whether it makes the verdict ``wrong``
    error_before: tuple[float, ...] | None = None  # (n) of the plain fit, N·m
    error_after: tuple[float, ...] | None = None  # (n) the same with the correction
    ratio: float | None = None  # of after to before, on the joints that show it

    def to_dict(self) -> dict[str, Any]:
        """Return the finding for JSON; joints from 1."""
        return {
            "premise": self.premise,
            "joints": [j + 1 for j in self.joints],
            "value": dict(self.value),
            "error_before": None if self.error_before is None else list(self.error_before),
            "error_after": None if self.error_after is None else list(self.error_after),
            "ratio": self.ratio,
            "sentence": self.sentence,
            "remedy": self.remedy,
        }


def fall(before: Array, after: Array, joints: Sequence[int]) -> str:
    """Return the fall of the errors (n,) of some joints in words."""
    numbers = [str(j + 1) for j in joints]
    names = f"joint{'s' if len(numbers) > 1 else ''} {', '.join(numbers)}"
    if len(numbers) > 2 and joints[-1] - joints[0] == len(joints) - 1:
        names = f"joints {numbers[0]}–{numbers[-1]}"
    first, last = (" ".join(f"{x[j]:.3g}" for j in joints) for x in (before, after))
    return f"the error of {names} falls from {first} to {last} N·m"


@dataclass(frozen=True)
class PremiseCheck:
    """Whether robot and recording belong together.

    Attributes
    ----------
    findings : tuple of Finding
        Strongest first.
    checked : tuple of str
        Premises that were tested.
    not_checkable : tuple of (str, str)
        Premises that this recording cannot test, and why.
    """

    findings: tuple[Finding, ...]
    checked: tuple[str, ...]
    not_checkable: tuple[tuple[str, str], ...] = ()

    @property
    def verdict(self) -> Verdict:
        """``wrong`` if a finding is certain, ``doubtful`` with any other, else ``sound``."""
        if any(finding.certain for finding in self.findings):
            return "wrong"
        return "doubtful" if self.findings else "sound"

    @property
    def sentence(self) -> str:
        """The verdict in words."""
        if not self.findings and len(self.not_checkable) > len(self.checked):
            return "No premise was found to be wrong; most could not be checked."
        return {
            "wrong": "Robot and recording do not belong together as they are given.",
            "doubtful": "Robot and recording are consistent, with doubts.",
            "sound": "Robot and recording belong together: no premise was found to be wrong.",
        }[self.verdict]

    @property
    def refusal(self) -> str:
        """What is certainly wrong, as one sentence; empty if nothing is."""
        certain = [finding for finding in self.findings if finding.certain]
        names = ", ".join(finding.premise for finding in certain)
        text = f"robot and recording do not belong together ({names})"
        return f"{text}: {certain[0].sentence}" if certain else ""

    @property
    def table(self) -> Table:
        """Errors without and with each correction."""
        rows = []
        for finding in self.findings:
            before, after = finding.error_before, finding.error_after
            if before is not None:
                rows.append((finding.premise, "as recorded", *map(figures, before)))
            if after is not None:
                rows.append(("", "corrected", *map(figures, after)))
        n = max((len(row) for row in rows), default=2) - 2
        return make_table(
            "Error of a plain fit, N·m",
            ("premise", "", *(f"joint {j + 1}" for j in range(n))),
            rows,
        )

    def to_dict(self) -> dict[str, Any]:
        """Return the result for JSON."""
        return {
            "verdict": self.verdict,
            "findings": [finding.to_dict() for finding in self.findings],
            "checked": list(self.checked),
            "not_checkable": [{"premise": p, "why": why} for p, why in self.not_checkable],
        }

    def _repr_html_(self) -> str:
        return html(self.sentence, *(f.sentence for f in self.findings), self.table)
