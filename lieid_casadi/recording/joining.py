"""Several recordings as one."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import Any

import numpy as np

from lieid_casadi.errors import RecordingError
from lieid_casadi.recording.arrays import Array, hash_of_arrays
from lieid_casadi.recording.measurement import OPTIONAL_SIGNALS
from lieid_casadi.recording.recording import Recording
from lieid_casadi.recording.sample_timing import gap_limit


def join(recordings: Sequence[Recording]) -> Recording:
    """Return one recording of several with the same joints; each keeps its own segments.

    The clock of a recording is kept where it comes from the same source and follows its
    predecessor; otherwise it is shifted so that a gap separates the two. Signals that one of
    them lacks are left out.

    Raises
    ------
    RecordingError
        No recording, or different numbers of joints.
    """
    if not recordings:
        raise RecordingError("join: no recordings, expected at least one")
    first = recordings[0]
    for other in recordings[1:]:
        if other.n != first.n:
            raise RecordingError(
                f"join: {other.title} has {other.n} joints, expected {first.n} as {first.title}"
            )
    signals: dict[str, Any] = {
        field: np.concatenate([getattr(r, field) for r in recordings])
        for field in ("q", *OPTIONAL_SIGNALS)
        if all(getattr(r, field) is not None for r in recordings)
    }

    def same(field: str) -> bool:
        return len({getattr(r, field) for r in recordings}) == 1

    labels: list[str] | None = None
    if any(r.payload_label is not None for r in recordings):
        labels = [label for r in recordings for label in r.payload_label or [""] * len(r)]
    return Recording(
        t=np.concatenate(_times(recordings)),
        payload_label=None if labels is None else tuple(labels),
        name="+".join(r.name for r in recordings if r.name),
        source_hash=hash_of_arrays([tuple(r.source_hash for r in recordings)]),
        warnings=tuple(w for r in recordings for w in r.warnings),
        torque_constants=first.torque_constants if same("torque_constants") else None,
        units=first.units if same("units") else (),
        **signals,
    )


def _times(recordings: Sequence[Recording]) -> list[Array]:
    """Return the stamps of each recording on one clock."""
    times = [recordings[0].t]
    pause = 2.0 * max(gap_limit(r.t) for r in recordings)
    for previous, following in pairwise(recordings):
        last = times[-1][-1]
        continues = previous.source_hash == following.source_hash
        if following.t[0] > last + (0.0 if continues else pause):
            times.append(following.t)
        else:
            times.append(following.t - following.t[0] + last + pause)
    return times
