"""Errors per joint."""

from __future__ import annotations

import numpy as np

from lieid_casadi.comparison import Comparison
from lieid_casadi.comparison.noise_floor import SOURCES
from lieid_casadi.comparison.table import HEADINGS, table_rows
from lieid_casadi.report.section import Section


def errors_section(comparison: Comparison) -> Section:
    """Return the table of errors, one row per joint."""
    c = comparison
    parts = np.nan_to_num(np.clip(c.relative_rms, 0.0, 1.0))
    longest = max(float(parts.max()), 1e-12)
    return Section(
        "Error per joint",
        "errors.html",
        {
            "headings": HEADINGS,
            "rows": [
                {"cells": row, "bar": round(100.0 * float(part) / longest, 1)}
                for row, part in zip(table_rows(c), parts, strict=True)
            ],
            "bar_column": HEADINGS.index("of torque"),
            "cutoff": f"{c.cutoff:.3g}",
            "noise": SOURCES[c.noise_source],
        },
    )
