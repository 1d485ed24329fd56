"""Tables of a comparison: errors per joint, and the largest errors."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from lieid_casadi.comparison.noise_floor import SOURCES
from lieid_casadi.tables import Table, html, make_table

if TYPE_CHECKING:
    from lieid_casadi.comparison.comparison import Comparison

HEADINGS = (
    "joint",
    "in motion",
    "noise floor",
    "of torque",
    "at rest",
    "all",
    "raw",
    "correlation",
    "bias",
    "unit",
)


def error_table(comparison: Comparison) -> Table:
    """Return the errors, one row per joint, with the columns `HEADINGS`."""
    c = comparison
    relative = c.relative_rms_moving
    rows = [
        (
            joint_title(c, j),
            digits(c.rms_moving[j]),
            digits(c.noise_floor[j]),
            percent(relative[j]),
            digits(c.rms_at_rest[j]),
            digits(c.rms[j]),
            digits(c.rms_raw[j]),
            "–" if math.isnan(c.correlation[j]) else f"{c.correlation[j]:.4f}",
            digits(c.bias[j], sign="+"),
            c.units[j],
        )
        for j in range(c.n)
    ]
    source = SOURCES[c.noise_source]
    title = (
        f"Error, measured − predicted (low-pass {c.cutoff:.3g} Hz on both; noise floor: {source})"
    )
    note = (
        f"Error: measured − predicted torque, both filtered by a zero-phase low-pass of "
        f"{c.cutoff:.3g} Hz; raw: resampled only. In motion, at rest: RMS while the joint moves "
        "and while it is at rest, where friction is undetermined. Of torque: RMS relative to the "
        "RMS of the measured torque, both in motion. "
        f"Noise floor: {source}."
    )
    return make_table(title, HEADINGS, rows, note=note)


def largest_errors_table(comparison: Comparison) -> Table:
    """Return the samples with the largest errors, a few for each joint."""
    headings = ("joint", "recording", "time, s", "error", "measured", "q", "q̇", "unit")
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
    return make_table("Largest errors", headings, rows)


def joint_title(comparison: Comparison, joint: int) -> str:
    """Return a joint's number, from 1, and its name unless it is that number."""
    name = comparison.joint_names[joint]
    return f"{joint + 1} {name}" if name and name != str(joint + 1) else f"{joint + 1}"


def digits(value: float, *, sign: str = "") -> str:
    """Return three significant digits, an en dash for NaN."""
    return "–" if math.isnan(value) else f"{value:{sign}#.3g}".rstrip(".")


def percent(value: float) -> str:
    """Return a fraction in percent, an en dash for NaN."""
    if math.isnan(value):
        return "–"
    text = f"{100.0 * value:#.2g}" if value < 0.995 else f"{100.0 * value:.0f}"
    return text.rstrip(".") + " %"


def html_view(comparison: Comparison) -> str:
    """Return the errors and the warnings as HTML."""
    names = ", ".join(source.name or "recording" for source in comparison.recordings)
    warnings = [f"{type(w).__name__}: {w}" for w in comparison.warnings]
    return html(f"{names}, {comparison.duration:.4g} s", error_table(comparison), *warnings)
