"""What makes a recording certainly wrong, whatever the arm: NaN, Inf, time going back."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from lieid_casadi.errors import RecordingError
from lieid_casadi.recording.readers.columns import FIELDS

if TYPE_CHECKING:
    from lieid_casadi.recording.recording import Recording


@dataclass(frozen=True)
class Fault:
    """One fault and where it is; row from 0, column by its name in files."""

    message: str
    row: int | None = None
    column: str = ""

    def __str__(self) -> str:
        return self.message


def first_fault(recording: Recording) -> Fault | None:
    """First fault of a recording, or None: too short, not finite, time not increasing."""
    if len(recording) < 2:
        rows = "one row" if len(recording) else "no rows"
        return Fault(f"found {rows}, expected at least two")
    return _not_finite(recording) or _not_increasing(recording)


def _not_finite(recording: Recording) -> Fault | None:
    faults = []
    bad_times = np.nonzero(~np.isfinite(recording.t))[0]
    if bad_times.size:
        row = int(bad_times[0])
        faults.append(Fault(_finite(recording.t[row]), row, "t"))
    for prefix, field in FIELDS.items():
        values = getattr(recording, field)
        if values is None or np.all(np.isfinite(values)):
            continue
        row, joint = (int(index) for index in np.argwhere(~np.isfinite(values))[0])
        faults.append(Fault(_finite(values[row, joint]), row, f"{prefix}{joint + 1}"))
    return min(faults, key=lambda fault: fault.row or 0, default=None)


def _finite(value: float) -> str:
    return f"found {value:g}, expected a finite number"


def _not_increasing(recording: Recording) -> Fault | None:
    rows = np.nonzero(np.diff(recording.t) <= 0.0)[0]
    if not rows.size:
        return None
    row = int(rows[0]) + 1
    before, here = recording.t[row - 1], recording.t[row]
    if before == here:
        return Fault(f"found the time {here:.9g} s twice, expected increasing time", row, "t")
    return Fault(
        f"found {here:.9g} s after {before:.9g} s (time goes back), expected increasing time",
        row,
        "t",
    )


def require_sound(recording: Recording) -> None:
    """Refuse what is wrong in any recording: RecordingError names the first row."""
    fault = first_fault(recording)
    if fault is None:
        return
    title = recording.name or "recording"
    place = "" if fault.row is None else f"row {fault.row + 1}, column {fault.column}: "
    raise RecordingError(f"{title}: {place}{fault}")
