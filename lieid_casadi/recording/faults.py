"""Values that no recording may contain, whatever the arm: NaN, Inf, time that goes back."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from lieid_casadi.errors import RecordingError
from lieid_casadi.recording.arrays import Array
from lieid_casadi.recording.measurement import FIELDS, Measurement

#: Largest magnitude of a signal (SI units): squares and sums of larger values lose all digits.
LARGEST_SIGNAL = 1e12
#: Largest time stamp, s, so that nanoseconds since 1970 read as seconds are still found below.
LARGEST_TIME = 1e20


@dataclass(frozen=True)
class Fault:
    """One fault and its place; row from 0, column by its name in files."""

    message: str
    row: int | None = None
    column: str = ""

    def __str__(self) -> str:
        return self.message


def first_fault(measurement: Measurement) -> Fault | None:
    """Return the first fault, or None: too short, not finite, too large, time not increasing."""
    if len(measurement) < 2:
        rows = "one row" if len(measurement) else "no rows"
        return Fault(f"found {rows}, expected at least two")
    return _out_of_range(measurement) or _not_increasing(measurement.t)


def _out_of_range(measurement: Measurement) -> Fault | None:
    """Return the first value that is not finite or too large to compute with."""
    faults = []
    bad_times = np.nonzero(~(np.abs(measurement.t) <= LARGEST_TIME))[0]
    if bad_times.size:
        row = int(bad_times[0])
        faults.append(Fault(_expected(measurement.t[row], LARGEST_TIME), row, "t"))
    for prefix, field in FIELDS.items():
        values = getattr(measurement, field)
        if values is None:
            continue
        bad = ~(np.abs(values) <= LARGEST_SIGNAL)
        if bad.any():
            row, joint = (int(index) for index in np.argwhere(bad)[0])
            column = f"{prefix}{joint + 1}"
            faults.append(Fault(_expected(values[row, joint], LARGEST_SIGNAL), row, column))
    return min(faults, key=lambda fault: fault.row or 0, default=None)


def _expected(value: float, largest: float) -> str:
    if np.isfinite(value):
        return f"found {value:g}, expected a magnitude of at most {largest:g} (SI units)"
    return f"found {value:g}, expected a finite number; delete rows without a measurement"


def _not_increasing(t: Array) -> Fault | None:
    rows = np.nonzero(np.diff(t) <= 0.0)[0]
    if not rows.size:
        return None
    row = int(rows[0]) + 1
    before, here = t[row - 1], t[row]
    if before == here:
        return Fault(
            f"found the time {here:.9g} s twice, expected increasing time; delete repeated rows",
            row,
            "t",
        )
    return Fault(
        f"found {here:.9g} s after {before:.9g} s (time goes back), expected increasing time",
        row,
        "t",
    )


def require_sound(measurement: Measurement) -> None:
    """Refuse a measurement with a fault.

    Raises
    ------
    RecordingError
        Names the first row and column with a fault.
    """
    fault = first_fault(measurement)
    if fault is None:
        return
    place = "" if fault.row is None else f"row {fault.row + 1}, column {fault.column}: "
    raise RecordingError(f"{measurement.title}: {place}{fault}")
