"""What was suspicious."""

from __future__ import annotations

from collections.abc import Sequence

from lieid_casadi.errors import LieidWarning, warning_list
from lieid_casadi.report.section import Section


def warnings_section(
    told: Sequence[LieidWarning], of_training: Sequence[LieidWarning] = ()
) -> Section:
    """Return the warnings of a result, and those of the fit behind it."""
    groups = [
        {"title": title, "warnings": warning_list(warnings)}
        for title, warnings in (("", told), ("Told when the model was fitted", of_training))
        if warnings
    ]
    return Section("Warnings", "warnings.html", {"groups": groups})
