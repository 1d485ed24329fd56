"""RLOESS: robust local regression on acceleration and torque (paper, section 6.2)."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from lieid_casadi.errors import MissingDependency
from lieid_casadi.recording.arrays import Array, read_only

if TYPE_CHECKING:
    from lieid_casadi.recording.processing import Processed


def smooth(processed: Processed) -> Processed:
    """The same segment with ddq and tau smoothed over one period of the cut-off.

    Outliers lose their weight, which no linear filter can do; for the same reason the
    smoothed torque is no longer the columns' own filter, so the window is kept short.

    Raises
    ------
    MissingDependency
        statsmodels is not installed.
    """
    window = max(7.0, processed.rate / processed.cutoff)
    fraction = min(1.0, window / len(processed))
    tau = processed.tau
    return replace(
        processed,
        ddq=_loess(processed.t, processed.ddq, fraction),
        tau=None if tau is None else _loess(processed.t, tau, fraction),
    )


def _loess(t: Array, x: Array, fraction: float) -> Array:
    try:
        from statsmodels.nonparametric.smoothers_lowess import lowess
    except ImportError as error:
        raise MissingDependency(
            "RLOESS needs statsmodels: pip install 'lieid-casadi[loess]'"
        ) from error
    smoothed = [
        lowess(column, t, frac=fraction, it=3, is_sorted=True, return_sorted=False)
        for column in x.T
    ]
    return read_only(np.column_stack(smoothed))
