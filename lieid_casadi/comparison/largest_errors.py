"""Largest errors of a model along recordings."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from lieid_casadi.comparison.time_series import Series

PER_JOINT = 3
APART = 1.0  # s, smallest time between two errors of one joint


@dataclass(frozen=True)
class LargeError:
    """An instant at which a joint's error is large.

    Attributes
    ----------
    recording : str
    time : float
        On the recording's clock, s.
    joint : int
        From 0.
    error, measured : float
        Measured − predicted torque, and measured torque, N·m (N for a prismatic joint).
    q, dq : float
        Position and velocity, rad and rad/s (m and m/s for a prismatic joint).
    moving : bool
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
        """Return plain data for JSON, with joints from 1."""
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


def largest_errors(
    series: Sequence[Series], *, per_joint: int = PER_JOINT, apart: float = APART
) -> tuple[LargeError, ...]:
    """Return the largest errors of each joint, largest first.

    Parameters
    ----------
    series : sequence of Series
    per_joint : int
        Number of errors per joint.
    apart : float
        Smallest time between two of them, s.
    """
    found: list[LargeError] = []
    for joint in range(series[0].error.shape[1]):
        candidates = [m for each in series for m in _peaks(each, joint, per_joint, apart)]
        candidates.sort(key=lambda found: -abs(found.error))
        found += candidates[:per_joint]
    return tuple(found)


def _peaks(series: Series, joint: int, count: int, apart: float) -> list[LargeError]:
    size = np.abs(series.error[:, joint])
    allowed = np.ones(size.size, dtype=bool)
    peaks: list[LargeError] = []
    while len(peaks) < count and allowed.any():
        k = int(np.argmax(np.where(allowed, size, -1.0)))
        allowed &= np.abs(series.time - series.time[k]) >= apart
        peaks.append(
            LargeError(
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
