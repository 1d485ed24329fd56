"""Table of the errors per joint: rows for the terminal, HTML for notebooks."""

from __future__ import annotations

import math
from html import escape
from typing import TYPE_CHECKING

from lieid_casadi.comparison.noise_floor import SOURCES
from lieid_casadi.html_table import html_table

if TYPE_CHECKING:
    from lieid_casadi.comparison.comparison import Comparison

HEADINGS = (
    "joint",
    "RMS",
    "in motion",
    "at rest",
    "raw",
    "of torque",
    "correlation",
    "bias",
    "noise floor",
    "unit",
)


def table_rows(comparison: Comparison) -> list[tuple[str, ...]]:
    """Return one row of text per joint, with the columns `HEADINGS`."""
    c = comparison
    return [
        (
            joint_title(c, j),
            digits(c.rms[j]),
            digits(c.rms_moving[j]),
            digits(c.rms_at_rest[j]),
            digits(c.rms_raw[j]),
            percent(c.relative_rms[j]),
            "–" if math.isnan(c.correlation[j]) else f"{c.correlation[j]:.4f}",
            digits(c.bias[j], sign="+"),
            digits(c.noise_floor[j]),
            c.units[j],
        )
        for j in range(c.n)
    ]


def joint_title(comparison: Comparison, joint: int) -> str:
    """Return a joint's number, from 1, and its name unless it is that number."""
    name = comparison.joint_names[joint]
    return f"{joint + 1} {name}" if name and name != str(joint + 1) else f"{joint + 1}"


def digits(value: float, *, sign: str = "") -> str:
    """Return three significant digits, an en dash for NaN."""
    return "–" if math.isnan(value) else f"{value:{sign}#.3g}".rstrip(".")


def percent(value: float) -> str:
    """Return a fraction in percent, an en dash for NaN."""
    return "–" if math.isnan(value) else f"{100.0 * value:#.2g}".rstrip(".") + " %"


def html_view(comparison: Comparison) -> str:
    """Return the table and the warnings as HTML; names and messages are escaped."""
    names = ", ".join(source.name or "recording" for source in comparison.recordings)
    warnings = "".join(
        f"<li><b>{escape(type(w).__name__)}</b>: {escape(str(w))}</li>" for w in comparison.warnings
    )
    return (
        f"<p>{escape(names)}, {comparison.duration:.4g} s, low-pass {comparison.cutoff:.3g} Hz, "
        f"noise floor: {escape(SOURCES[comparison.noise_source])}</p>"
        + html_table(HEADINGS, table_rows(comparison))
        + (f"<ul>{warnings}</ul>" if warnings else "")
    )
