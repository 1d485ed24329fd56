"""What a reader of a comparison must be told before the numbers are believed."""

from __future__ import annotations

import re

import numpy as np

from lieid_casadi.comparison.comparison import Comparison
from lieid_casadi.errors import FrictionAtRestWarning, LieidWarning, SameRecordingWarning
from lieid_casadi.identification.fit import Fit, Source
from lieid_casadi.identification.regression.design_matrix import has_dry_friction

_NUMBER = r"(?:[-+]?\d+(?:\.\d+)?(?:[eE][-+]?\d+)?)?"
_PART = re.compile(rf"@(?P<start>{_NUMBER}):(?P<end>{_NUMBER})$")


def findings(fit: Fit, comparison: Comparison) -> list[LieidWarning]:
    """Return warnings about the comparison itself, beside those of its recordings."""
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
            f"the fit was made from {', '.join(again)}: the errors are of training, "
            "and smaller than on other motion"
        )
    ]


def _overlap(a: Source, b: Source) -> bool:
    """Whether two recordings share samples: same data, and parts of it that overlap."""
    if not a.sha256 or a.sha256 != b.sha256:
        return False
    (start, end), (other_start, other_end) = _part(a.name), _part(b.name)
    return start < other_end and other_start < end


def _part(name: str) -> tuple[float, float]:
    """Return the ends, s, of a part ``…@T0:T1``; everything if the name states none."""
    match = _PART.search(name)
    if match is None:
        return -np.inf, np.inf
    return float(match["start"] or -np.inf), float(match["end"] or np.inf)


def _rest(fit: Fit, comparison: Comparison) -> list[LieidWarning]:
    """Tell joints whose error at rest, where dry friction is anyone's guess, weighs in the RMS."""
    told = np.flatnonzero(has_dry_friction(fit.model) & comparison.rest_weighs)
    if not told.size:
        return []
    details = ", ".join(
        f"joint {j + 1} (RMS {comparison.rms_at_rest[j]:.3g} at rest, "
        f"{comparison.rms_moving[j]:.3g} {comparison.units[j]} moving; "
        f"{comparison.at_rest[j]:.0%} of the time at rest)"
        for j in told
    )
    return [
        FrictionAtRestWarning(
            f"friction at rest is undetermined and weighs in the error of {details}: "
            "judge these joints by the RMS moving"
        )
    ]
