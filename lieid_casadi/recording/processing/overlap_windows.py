"""Zero-phase filtering in windows that overlap by the length of the filter's response.

The response of a forward-backward Butterworth filter is infinite but decays: beyond
:func:`filter_memory` samples it is below double precision, so that windows with that margin give
the same rows as the whole signal, ends of the segment included.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from scipy.signal import butter

from lieid_casadi.recording.processing.filtering import HIGHEST_CUTOFF

#: Relative size of the response beyond the filter's memory.
NEGLIGIBLE = 1e-14
#: Instants per window, at least; with margins of a tenth little is filtered twice.
WINDOW = 8192


@dataclass(frozen=True)
class Window:
    """A stretch of filtered rows and the instants from which they are computed.

    Attributes
    ----------
    rows
        Rows of the filtered signal.
    instants
        Instants of the signal on the grid, margins included.
    inside
        Positions of the rows among the instants of this window.
    """

    rows: slice
    instants: slice
    inside: slice


def filter_memory(rate: float, cutoff: float, order: int = 4) -> int:
    """Return the number of samples after which the response of :func:`lowpass` is below 1e-14.

    Parameters
    ----------
    rate : float
        Hz.
    cutoff : float
        Hz.
    order : int
        Of the Butterworth filter (one way).
    """
    if cutoff >= HIGHEST_CUTOFF * rate:
        return 0
    _, poles, _ = butter(order, cutoff, fs=rate, output="zpk")
    slowest = -np.log(np.abs(poles).max())
    # both ways: poles are double, and the response fades as (1 + k) times a power
    return int(np.ceil((-np.log(NEGLIGIBLE) + 3.0) / slowest))


def windows(count: int, kept: slice, margin: int, size: int | None = None) -> Iterator[Window]:
    """Yield windows that cover the kept instants of ``count``.

    Parameters
    ----------
    count
        Instants on the grid.
    kept
        ``slice(first, end, step)``: the instants that become rows.
    margin
        The filter's memory, in instants.
    size
        Instants per window without margins; at least ten margins if left out.
    """
    step = kept.step or 1
    total = len(range(*kept.indices(count)))
    rows = max(1, (size or max(WINDOW, 10 * margin)) // step)
    pieces = max(1, -(-total // rows))
    edges = [total * k // pieces for k in range(pieces + 1)]
    for first, last in pairwise(edges):
        start = 0 if first == 0 else max(0, kept.start + first * step - margin)
        end = count if last == total else min(count, kept.start + (last - 1) * step + 1 + margin)
        begin = kept.start + first * step - start
        inside = slice(begin, begin + (last - first - 1) * step + 1, step)
        yield Window(slice(first, last), slice(start, end), inside)
