"""How many threads share a batch of samples, and which samples each of them takes."""

from __future__ import annotations

import os
import re

SAMPLES_PER_THREAD = 8192  # below it starting a thread takes longer than it saves


def default_threads() -> int:
    """Return $LIEID_THREADS (1 to 9999), else two, or one if only one processor may be used."""
    stated = os.environ.get("LIEID_THREADS", "")
    if re.fullmatch("[1-9][0-9]{0,3}", stated):
        return int(stated)
    return min(2, len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else 2)


def slices(samples: int, threads: int, lanes: int) -> list[tuple[int, int]]:
    """Return the first and last + 1 of the samples of each thread; all but the last whole lanes.

    ``samples``, ``threads``: how many there are; ``lanes``: samples per vector register.
    """
    count = min(threads, samples // SAMPLES_PER_THREAD)
    if count <= 1:
        return [(0, samples)]
    step = -(-samples // (count * lanes)) * lanes
    return [(first, min(first + step, samples)) for first in range(0, samples, step)]
