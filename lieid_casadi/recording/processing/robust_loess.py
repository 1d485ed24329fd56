"""RLOESS: robust local regression on acceleration and torque (paper, section 6.2)."""

from __future__ import annotations

import numpy as np

from lieid_casadi.errors import MissingDependency
from lieid_casadi.recording.arrays import Array

#: Length of the window in periods of the cut-off: shorter ones follow single outliers,
#: longer ones round off the steps of friction.
WINDOW = 1.5


def robust_loess(t: Array, x: Array, cutoff: float) -> Array:
    """Smooth columns x (K, n) at times t (K,) over 1.5 periods of the cut-off, Hz.

    Outliers lose their weight, which no linear filter can do; for the same reason the
    smoothed torque has no longer gone through the filter of the columns alone.

    Raises
    ------
    MissingDependency
        statsmodels is not installed.
    """
    try:
        from statsmodels.nonparametric.smoothers_lowess import lowess
    except ImportError as error:
        raise MissingDependency(
            "RLOESS needs statsmodels: pip install 'lieid-casadi[loess]'"
        ) from error
    window = WINDOW / cutoff
    count = max(7.0, window * (t.size - 1) / (t[-1] - t[0]))
    smoothed = [
        lowess(
            column,
            t,
            frac=min(1.0, count / t.size),
            it=3,
            delta=0.02 * window,
            is_sorted=True,
            return_sorted=False,
        )
        for column in x.T
    ]
    return np.column_stack(smoothed)
