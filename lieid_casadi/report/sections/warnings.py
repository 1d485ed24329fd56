"""Warnings of a result and of its fit."""

from __future__ import annotations

from collections.abc import Sequence

from lieid_casadi.errors import LieidWarning, warning_list
from lieid_casadi.report.section import Section


def warnings_section(
    warnings: Sequence[LieidWarning], of_fit: Sequence[LieidWarning] = ()
) -> Section:
    """Return the warnings of a result, and those of the fit that it uses."""
    groups = [
        {"title": title, "warnings": warning_list(group)}
        for title, group in (("", warnings), ("Warnings of the fit", of_fit))
        if group
    ]
    return Section("Warnings", "warnings.html", {"groups": groups})
