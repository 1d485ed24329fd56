"""Paths that name a part of a recording: ``FILE@T0:T1``."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from lieid_casadi.errors import RecordingError
from lieid_casadi.recording.arrays import Array

_PART = re.compile(r"(?P<path>.+)@(?P<start>[^:@/]*):(?P<end>[^:@/]*)")


def split_part(path: str | Path) -> tuple[Path, float | None, float | None]:
    """Return file and ends, s, of ``FILE@T0:T1``; open ends are None.

    Raises
    ------
    RecordingError
        Ends that are not finite numbers, or not in order.
    """
    match = _PART.fullmatch(str(path))
    if match is None or Path(path).exists():
        return Path(path), None, None
    first, last = (_end(path, match[name]) for name in ("start", "end"))
    if first is not None and last is not None and not first < last:
        raise RecordingError(f"{path}: found {first:g} to {last:g} s, expected T0 < T1")
    return Path(match["path"]), first, last


def part_label(start: float | None, end: float | None) -> str:
    """Return how a part is written behind a path: ``@T0:T1``, without the ends that are open."""
    return "@" + ":".join("" if limit is None else format(limit, "g") for limit in (start, end))


def rows_of_part(t: Array, start: float | None, end: float | None) -> tuple[int, int]:
    """Return the first row with t ≥ start, and the first with t ≥ end.

    Parameters
    ----------
    t
        (N,) stamps, s, increasing.
    start, end
        s; None: from the first row, to the last.
    """
    low = -np.inf if start is None else float(start)
    high = np.inf if end is None else float(end)
    first, last = np.searchsorted(t, [low, high], side="left")
    return int(first), int(last)


def _end(path: str | Path, text: str) -> float | None:
    if not text.strip():
        return None
    try:
        end = float(text)
    except ValueError:
        end = np.nan
    if not np.isfinite(end):
        raise RecordingError(
            f"{path}: found {text!r} after @, expected FILE@T0:T1 with T0, T1 in seconds"
        )
    return end
