"""Stretches of recordings: without what is excluded, and evenly spread ones for quick fits."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from pathlib import PurePath

import numpy as np

from lieid_casadi.errors import RecordingError
from lieid_casadi.recording import Recording
from lieid_casadi.workbench.state.inputs import WorkbenchInputs

MOST_STRETCHES = 8  # of each recording in a quick fit
LEAST_DURATION = 5.0  # s, of a stretch; the filter needs a second at each of its ends


def recording_titles(inputs: WorkbenchInputs) -> list[str]:
    """Return a short, unique title of each recording: its file name, its path if two are equal."""
    names = [PurePath(r.path).name for r in inputs.recordings]
    count = Counter(names)
    paths = Counter(r.path for r in inputs.recordings)
    titles = []
    for k, (name, each) in enumerate(zip(names, inputs.recordings, strict=True)):
        if count[name] > 1:
            name = each.path if paths[each.path] == 1 else f"{each.path} ({k + 1})"
        titles.append(name)
    return titles


def without_excluded(
    recording: Recording, parts: Sequence[tuple[float | None, float | None]]
) -> list[Recording]:
    """Return the parts of a recording that have rows."""
    kept = []
    for start, end in parts:
        if start is None and end is None:
            return [recording]
        try:
            kept.append(recording.cut(start, end))
        except RecordingError:  # no rows between two excluded stretches
            continue
    return kept


def evenly_spread(recording: Recording, share: float) -> list[Recording]:
    """Return stretches that together have this share of a recording, evenly spread over it."""
    count = int(np.clip(share * recording.duration / LEAST_DURATION, 1, MOST_STRETCHES))
    edges = np.linspace(0, len(recording), count + 1)
    length = share * len(recording) / count
    return [recording.rows(int(first), int(first + length)) for first in edges[:-1]]
