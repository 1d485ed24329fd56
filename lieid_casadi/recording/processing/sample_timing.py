"""What counts as a lost sample and what as a gap between segments."""

from __future__ import annotations

import numpy as np

from lieid_casadi.recording.arrays import Array

#: A pause is a gap when it is both this many sample periods long ...
GAP_PERIODS = 5.0
#: ... and this many seconds: shorter holes hide no motion of an arm and are interpolated.
GAP_SECONDS = 0.05


def sample_period(t: Array) -> float:
    """Median time between samples, s (t: (N,), N ≥ 2)."""
    return float(np.median(np.diff(t)))


def gap_limit(t: Array) -> float:
    """Step in time, s, beyond which two samples belong to different segments."""
    return max(GAP_PERIODS * sample_period(t), GAP_SECONDS)


def dropout_limit(t: Array) -> float:
    """Step in time, s, beyond which samples were lost between two neighbours.

    Irregular stamps are no loss: the limit lies above the spread of the steps (their
    90th percentile), and above 1.75 sample periods.
    """
    steps = np.diff(t)
    return float(max(1.75 * np.median(steps), 1.45 * np.percentile(steps, 90.0)))
