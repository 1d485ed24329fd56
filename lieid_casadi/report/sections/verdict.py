"""Verdict of a comparison."""

from __future__ import annotations

from lieid_casadi.comparison import Comparison
from lieid_casadi.comparison.verdict import verdict
from lieid_casadi.report.section import Section


def verdict_section(comparison: Comparison) -> Section:
    """Return the sentence at the beginning of a report."""
    return Section("", "verdict.html", {"sentence": verdict(comparison)})
