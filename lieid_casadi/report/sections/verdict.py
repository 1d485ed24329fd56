"""The comparison in a sentence."""

from __future__ import annotations

from lieid_casadi.comparison import Comparison
from lieid_casadi.comparison.verdict import verdict
from lieid_casadi.report.section import Section


def verdict_section(comparison: Comparison) -> Section:
    """Return the sentence that a report opens with."""
    return Section("", "verdict.html", {"sentence": verdict(comparison)})
