"""Errors per joint."""

from __future__ import annotations

import numpy as np

from lieid_casadi.comparison import Comparison
from lieid_casadi.comparison.table import error_table, largest_errors_table
from lieid_casadi.report.section import Section, table_section


def errors_section(comparison: Comparison) -> Section:
    """Return the errors, one row per joint, with bars in proportion to the relative error."""
    table = error_table(comparison)
    parts = np.nan_to_num(np.clip(comparison.relative_rms_moving, 0.0, 1.0))
    longest = max(float(parts.max()), 1e-12)
    data = {
        "table": table,
        "bars": [round(100.0 * float(part) / longest, 1) for part in parts],
        "bar_column": table.headings.index("of torque"),
    }
    return Section("Error per joint", "errors.html", data)


def largest_errors_section(comparison: Comparison) -> Section:
    """Return the samples with the largest errors of every joint."""
    return table_section("Largest errors", largest_errors_table(comparison), folded=True)
