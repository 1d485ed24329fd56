"""Identified parameters with their standard deviations."""

from __future__ import annotations

import math
from typing import Any

from lieid_casadi.identification import Fit
from lieid_casadi.report.section import Section

SIGNIFICANT = 2.0  # standard deviations away from zero


def effects_section(fit: Fit) -> Section:
    """Return coefficients and shape parameters of the effects."""
    return _section("Effects", fit, [row for row in fit.parameter_table() if "." in row["name"]])


def links_section(fit: Fit) -> Section:
    """Return the base parameters of the links."""
    rows = [row for row in fit.parameter_table() if "." not in row["name"]]
    return _section("Base parameters of the links", fit, rows, folded=True)


def _section(title: str, fit: Fit, table: list[dict[str, Any]], *, folded: bool = False) -> Section:
    rows = [
        {
            "joint": row["joint"],
            "name": row["name"],
            "expression": _meaning(row),
            "value": value_text(row["value"], row["std"]),
            "std": "–" if row["std"] is None else f"{row['std']:#.2g}".rstrip("."),
            "unit": row["unit"],
            "weak": row["std"] is None or abs(row["value"]) < SIGNIFICANT * row["std"],
        }
        for row in table
    ]
    data = {
        "rows": rows,
        "weak": any(row["weak"] for row in rows),
        "combined": any(row["expression"] for row in rows),
    }
    return Section(title, "parameters.html", data, folded=folded)


def _meaning(row: dict[str, Any]) -> str:
    """Return the combination that a parameter is; empty if that is its name."""
    name, joint, expression = row["name"], row["joint"], str(row["expression"])
    return "" if expression in (name, f"{name}{joint}", f"{name}:{joint}") else expression


def value_text(value: float, std: float | None) -> str:
    """Return a value to the second digit of its standard deviation.

    Examples
    --------
    >>> value_text(12.3456, 0.021)
    '12.346'
    >>> value_text(12.3456, None)
    '12.35'
    """
    if not std:
        return f"{value:.4g}"
    decimals = 1 - math.floor(math.log10(std))
    return f"{value:z.{decimals}f}" if 0 <= decimals <= 8 else f"{value:.4g}"
