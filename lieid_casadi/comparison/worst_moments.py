"""The moments at which a model is furthest from the measurement."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from lieid_casadi.comparison.time_series import Series

PER_JOINT = 3
APART = 1.0  # s between two moments of one joint


@dataclass(frozen=True)
class Moment:
    """One instant at which a joint's error is large.

    ``joint`` counts from 0; ``time`` in s on the recording's clock; torques in N·m, position
    and speed in rad and rad/s (m and m/s for a sliding joint).
    """

    recording: str
    time: float
    joint: int
    error: float
    measured: float
    q: float
    dq: float
    moving: bool

    def to_dict(self) -> dict[str, Any]:
        """Return the moment as it stands in JSON, joint from 1."""
        return {
            "recording": self.recording,
            "time": self.time,
            "joint": self.joint + 1,
            "error": self.error,
            "measured": self.measured,
            "q": self.q,
            "dq": self.dq,
            "moving": self.moving,
        }


def worst_moments(
    series: Sequence[Series], *, per_joint: int = PER_JOINT, apart: float = APART
) -> tuple[Moment, ...]:
    """Return each joint's largest errors, worst first, at least ``apart`` seconds apart."""
    found: list[Moment] = []
    for joint in range(series[0].error.shape[1]):
        candidates = [m for each in series for m in _peaks(each, joint, per_joint, apart)]
        candidates.sort(key=lambda moment: -abs(moment.error))
        found += candidates[:per_joint]
    return tuple(found)


def _peaks(series: Series, joint: int, count: int, apart: float) -> list[Moment]:
    size = np.abs(series.error[:, joint])
    free = np.ones(size.size, dtype=bool)
    peaks: list[Moment] = []
    while len(peaks) < count and free.any():
        k = int(np.argmax(np.where(free, size, -1.0)))
        free &= np.abs(series.time - series.time[k]) >= apart
        peaks.append(
            Moment(
                recording=series.recording,
                time=float(series.time[k]),
                joint=joint,
                error=float(series.error[k, joint]),
                measured=float(series.measured[k, joint]),
                q=float(series.q[k, joint]),
                dq=float(series.dq[k, joint]),
                moving=bool(series.moving[k, joint]),
            )
        )
    return peaks
