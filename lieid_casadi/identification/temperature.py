"""Temperatures relative to the mean of the training recordings, as the effects use them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from lieid_casadi.recording.processed import Processed

Array = NDArray[np.float64]


def center_temperature(
    segments: Sequence[Processed], mean: Array | None = None
) -> tuple[tuple[Processed, ...], Array | None]:
    """Return segments with temperatures relative to a mean (n,), °C, and that mean.

    The mean is that over all segments if none is given. Segments are returned as they are if
    one of them has no temperature.
    """
    temperatures = [s.temperature for s in segments if s.temperature is not None]
    if len(temperatures) < len(segments):
        return tuple(segments), mean
    if mean is None:
        mean = np.concatenate(temperatures).mean(axis=0)
    return tuple(relative_temperature(segment, mean) for segment in segments), mean


def relative_temperature(segment: Processed, mean: Array | None) -> Processed:
    """Return a segment with temperatures relative to a mean (n,), °C."""
    if segment.temperature is None or mean is None:
        return segment
    return replace(segment, temperature=segment.temperature - mean)
