"""Warnings of a comparison: training data among the tests, and errors at rest."""

from __future__ import annotations

import re

import numpy as np

from lieid_casadi.comparison.comparison import Comparison
from lieid_casadi.errors import FrictionAtRestWarning, LieidWarning, SameRecordingWarning
from lieid_casadi.identification.fit import Fit
from lieid_casadi.identification.provenance import Source
from lieid_casadi.identification.regression.column_properties import has_dry_friction

_NUMBER = r"(?:[-+]?\d+(?:\.\d+)?(?:[eE][-+]?\d+)?)?"
_PART = re.compile(rf"(?:@| episodes )(?P<start>{_NUMBER}):(?P<end>{_NUMBER})$")


def comparison_warnings(fit: Fit, comparison: Comparison) -> list[LieidWarning]:
    """Return warnings about the comparison, without those of its recordings."""
    return [*_trained_on(fit, comparison), *_rest(fit, comparison)]


def _trained_on(fit: Fit, comparison: Comparison) -> list[LieidWarning]:
    again = [
        source.name or "a recording"
        for source in comparison.recordings
        if any(_overlap(source, trained) for trained in fit.provenance.recordings)
    ]
    if not again:
        return []
    return [
        SameRecordingWarning(
            f"{', '.join(again)} was used to fit the model: errors are training errors and smaller "
            "than on other recordings; compare with a recording that was not used"
        )
    ]


def _overlap(a: Source, b: Source) -> bool:
    """Return whether two recordings share samples: the same data with overlapping parts."""
    if not a.sha256 or a.sha256 != b.sha256:
        return False
    (start, end), (other_start, other_end) = _part(a.name), _part(b.name)
    return start < other_end and other_start < end


def _part(name: str) -> tuple[float, float]:
    """Return start and end of a part, s or episodes; infinite if the name states none."""
    match = _PART.search(name)
    if match is None:
        return -np.inf, np.inf
    return float(match["start"] or -np.inf), float(match["end"] or np.inf)


def _rest(fit: Fit, comparison: Comparison) -> list[LieidWarning]:
    """Return a warning that names joints whose RMS is dominated by rest with dry friction."""
    resting = np.flatnonzero(has_dry_friction(fit.model) & comparison.rest_dominates)
    if not resting.size:
        return []
    details = ", ".join(_rest_of(comparison, int(j)) for j in resting)
    moved = bool(np.isfinite(comparison.rms_moving[resting]).any())
    remedy = "use the RMS in motion for these joints" if moved else "compare a recording in motion"
    return [
        FrictionAtRestWarning(
            f"friction is undetermined at rest and dominates the error of {details}: {remedy}"
        )
    ]


def _rest_of(comparison: Comparison, joint: int) -> str:
    """Return a joint's errors at rest and in motion as text."""
    unit, moving = comparison.units[joint], comparison.rms_moving[joint]
    at_rest = f"joint {joint + 1} (RMS {comparison.rms_at_rest[joint]:.3g} {unit} at rest, "
    if not np.isfinite(moving):
        return f"{at_rest}never in motion)"
    return (
        f"{at_rest}{moving:.3g} {unit} in motion; {100 * comparison.at_rest[joint]:.2g} % of the "
        "time at rest)"
    )
