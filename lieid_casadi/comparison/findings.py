"""What a reader of a comparison must be told before the numbers are believed."""

from __future__ import annotations

import numpy as np

from lieid_casadi.comparison.comparison import Comparison
from lieid_casadi.errors import FrictionAtRestWarning, LieidWarning, SameRecordingWarning
from lieid_casadi.identification.design import has_dry_friction
from lieid_casadi.identification.fit import Fit

MATTERS = 0.25  # of a joint's squared error from samples at rest


def findings(fit: Fit, comparison: Comparison) -> list[LieidWarning]:
    """Return warnings about the comparison itself, beside those of its recordings."""
    return [*_trained_on(fit, comparison), *_rest(fit, comparison)]


def _trained_on(fit: Fit, comparison: Comparison) -> list[LieidWarning]:
    trained = {source for source in fit.provenance.recordings if source.sha256}
    again = [source.name or "a recording" for source in comparison.recordings if source in trained]
    if not again:
        return []
    return [
        SameRecordingWarning(
            f"the fit was made from {', '.join(again)}: the errors are of training, "
            "and smaller than on other motion"
        )
    ]


def _rest(fit: Fit, comparison: Comparison) -> list[LieidWarning]:
    """Tell joints whose error at rest, where dry friction is anyone's guess, weighs in the RMS."""
    squares = comparison.rms**2
    at_rest = comparison.at_rest * np.nan_to_num(comparison.rms_at_rest) ** 2
    part = np.divide(at_rest, squares, out=np.zeros_like(squares), where=squares > 0.0)
    larger = np.nan_to_num(comparison.rms_at_rest) > np.nan_to_num(comparison.rms_moving)
    told = np.flatnonzero(has_dry_friction(fit.model) & (part > MATTERS) & larger)
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
