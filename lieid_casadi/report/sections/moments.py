"""When the error is largest."""

from __future__ import annotations

from lieid_casadi.comparison import Comparison
from lieid_casadi.comparison.table import digits, joint_title
from lieid_casadi.report.section import Section


def moments_section(comparison: Comparison) -> Section:
    """Return the largest errors of every joint."""
    rows = [
        (
            joint_title(comparison, moment.joint),
            moment.recording,
            f"{moment.time:z.2f}",
            digits(moment.error, sign="+"),
            digits(moment.measured, sign="+"),
            f"{moment.q:z.3f}",
            f"{moment.dq:z.3f}" if moment.moving else "at rest",
            comparison.units[moment.joint],
        )
        for moment in comparison.worst
    ]
    headings = ("joint", "recording", "time, s", "error", "measured", "q", "q̇", "unit")
    data = {"headings": headings, "rows": rows}
    return Section("Largest errors", "moments.html", data, folded=True)
