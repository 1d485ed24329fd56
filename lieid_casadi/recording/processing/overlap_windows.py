"""Zero-phase filtering in windows: each reaches over its rows by as much as the filter remembers.

A forward-backward Butterworth filter has an infinite response, but one that fades: beyond
:func:`filter_memory` samples nothing is left of it in double precision, so that windows with that
margin give the same rows as the whole signal, ends of the segment included.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from scipy.signal import butter

from lieid_casadi.recording.processing.filtering import HIGHEST_CUTOFF

#: What is left of an impulse beyond the filter's memory.
QUIET = 1e-14
#: Instants per window, at least; with margins of a tenth little is filtered twice.
WINDOW = 8192


@dataclass(frozen=True)
class Window:
    """A stretch of filtered rows and what they need.

    Attributes
    ----------
    rows
        Of the filtered signal.
    instants
        Of the signal on the grid, margins included.
    inside
        Where the rows are among the instants of this window.
    """

    rows: slice
    instants: slice
    inside: slice


def filter_memory(rate: float, cutoff: float, order: int = 4) -> int:
    """Samples after which :func:`lowpass` has forgotten an impulse, to 1e-14 of it.

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
    return int(np.ceil((-np.log(QUIET) + 3.0) / slowest))


def windows(count: int, kept: slice, margin: int, size: int | None = None) -> Iterator[Window]:
    """Windows that cover the kept instants of ``count`` in turn.

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
