"""Measured signals as plain arrays: the result of a reader and the data of a recording."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import Any, Self

import numpy as np
from numpy.typing import ArrayLike

from lieid_casadi.arrays import Array, Indices, Mask
from lieid_casadi.errors import LieidWarning, RecordingError
from lieid_casadi.robot.drive import Drive

#: Prefix of the columns in files -> field of a measurement.
FIELDS = {
    "q": "q",
    "dq": "dq",
    "tau": "tau",
    "ddq": "ddq",
    "temp": "temperature",
    "i": "current",
    "qcmd": "command",
}
#: Optional signals with one column per joint.
OPTIONAL_SIGNALS = ("dq", "tau", "ddq", "temperature", "current", "command")


@dataclass(frozen=True, eq=False, repr=False)
class Measurement:
    """Signals of an arm with n joints at N instants, SI units; arrays are read-only.

    Signals that were not measured are None: they are derived in
    :func:`lieid_casadi.recording.process`, never on loading.
    """

    t: Array  # (N,) s; strictly increasing in a recording, stamps may be irregular
    q: Array  # (N, n) rad or m
    dq: Array | None = None
    tau: Array | None = None  # (N, n) N·m or N
    ddq: Array | None = None
    temperature: Array | None = None  # (N, n) °C
    current: Array | None = None  # (N, n) motor current, A
    command: Array | None = None  # (N, n) commanded position, rad or m
    payload_label: tuple[str, ...] | None = None  # of each row (column ``load``)
    torque_constants: tuple[float, ...] | None = None  # (n) N·m/A by which tau is from current
    drives: tuple[Drive, ...] | None = None  # (n) laws by which tau is from command
    units: tuple[str, ...] = ()  # of the source that were converted: deg; ms, us or ns
    columns: tuple[str, ...] = ()  # of the source assigned to signals, such as tau2=tau3
    corrections: tuple[str, ...] = ()  # options that corrected a premise
    pauses: tuple[float, ...] = ()  # s, stamps after which the recorder paused by intention
    name: str = ""  # of the file or other source
    source_hash: str = ""  # sha256 of the file's bytes, or of the arrays
    warnings: tuple[LieidWarning, ...] = ()  # found on loading

    def __post_init__(self) -> None:
        t = read_only(self.t)
        if t.ndim != 1:
            raise RecordingError(f"{self.title}: t has shape {t.shape}, expected (N,)")
        object.__setattr__(self, "t", t)
        q = read_only(self.q)
        if q.ndim != 2 or q.shape[0] != t.size or q.shape[1] == 0:
            raise RecordingError(f"{self.title}: q has shape {q.shape}, expected ({t.size}, n)")
        object.__setattr__(self, "q", q)
        for field in OPTIONAL_SIGNALS:
            values = getattr(self, field)
            if values is None:
                continue
            array = read_only(values)
            if array.shape != q.shape:
                raise RecordingError(
                    f"{self.title}: {field} has shape {array.shape}, expected {q.shape} as q"
                )
            object.__setattr__(self, field, array)
        if self.payload_label is not None:
            labels = tuple(str(label) for label in self.payload_label)
            if len(labels) != t.size:
                raise RecordingError(f"{self.title}: {len(labels)} load labels for {t.size} rows")
            object.__setattr__(self, "payload_label", labels)

    @property
    def title(self) -> str:
        """Name for the beginning of a message."""
        return self.name or "recording"

    @property
    def n(self) -> int:
        """Number of joints."""
        return int(self.q.shape[1])

    def __len__(self) -> int:
        return int(self.t.size)

    def __repr__(self) -> str:
        measured = [name for name in ("q", *OPTIONAL_SIGNALS) if getattr(self, name) is not None]
        return (
            f"<{type(self).__name__} {self.name or 'without name'}: {self.n} joints, {len(self)} "
            f"rows, {', '.join(measured)}>"
        )

    def rows(self, first: int, last: int) -> Self:
        """Return rows first … last − 1 (from 0)."""
        return self.at(slice(first, last))

    def at(self, rows: slice | Mask | Indices) -> Self:
        """Return the rows of a slice, a mask (N,) or numbers."""
        fields = ("t", "q", *OPTIONAL_SIGNALS)
        given = {field: getattr(self, field) for field in fields}
        signals = {field: x[rows] for field, x in given.items() if x is not None}
        label = self.payload_label
        chosen = None if label is None else tuple(np.asarray(label, dtype=object)[rows])
        return replace(self, payload_label=chosen, **signals)


def read_only(values: ArrayLike) -> Array:
    """Return a read-only float64 array: a copy, unless the memory is read-only already."""
    if isinstance(values, np.ndarray) and values.dtype == np.float64 and _frozen(values):
        return values
    array = np.array(values, dtype=np.float64, order="C")
    array.flags.writeable = False
    return array


def _frozen(values: Array) -> bool:
    """Return whether an array and every array that it is a view of are read-only."""
    owner: object = values
    while isinstance(owner, np.ndarray):
        if owner.flags.writeable:
            return False
        owner = owner.base
    return owner is None and bool(values.flags.c_contiguous)


def hash_of_arrays(arrays: Iterable[Any]) -> str:
    """Return the sha256 over shapes and bytes of the arrays, in order; None counts too."""
    digest = hashlib.sha256()
    for array in arrays:
        if array is None:
            digest.update(b"none;")
        elif isinstance(array, tuple):
            digest.update(repr(array).encode())
        else:
            digest.update(repr(array.shape).encode())
            digest.update(np.ascontiguousarray(array).tobytes())
    return digest.hexdigest()


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


def in_range(measurement: Measurement) -> Mask:
    """Mark rows (N,) whose values are finite and small enough to compute with."""
    sound = np.abs(measurement.t) <= LARGEST_TIME
    for field in FIELDS.values():
        values = getattr(measurement, field)
        if values is not None:
            sound &= np.all(np.abs(values) <= LARGEST_SIGNAL, axis=1)
    return np.asarray(sound)


def _out_of_range(measurement: Measurement) -> Fault | None:
    """Return the first value that is not finite or too large to compute with."""
    sound = in_range(measurement)
    if sound.all():
        return None
    row = int(np.argmin(sound))
    if not abs(measurement.t[row]) <= LARGEST_TIME:
        return Fault(_expected(measurement.t[row], LARGEST_TIME), row, "t")
    for prefix, field in FIELDS.items():
        values = getattr(measurement, field)
        if values is not None:
            for joint in np.flatnonzero(~(np.abs(values[row]) <= LARGEST_SIGNAL)):
                value = float(values[row, joint])
                return Fault(_expected(value, LARGEST_SIGNAL), row, f"{prefix}{joint + 1}")
    return None


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
    """Refuse a measurement with a fault; the error names its row and column."""
    fault = first_fault(measurement)
    if fault is not None:
        raise fault_error(measurement, fault)


def fault_error(measurement: Measurement, fault: Fault) -> RecordingError:
    """Return the error of a fault with its row and column."""
    place = "" if fault.row is None else f"row {fault.row + 1}, column {fault.column}: "
    return RecordingError(f"{measurement.title}: {place}{fault}")
