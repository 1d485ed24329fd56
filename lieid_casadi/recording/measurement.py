"""Measured signals as plain arrays: the result of a reader and the data of a recording."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, Self

from lieid_casadi.errors import LieidWarning, RecordingError
from lieid_casadi.recording.arrays import Array, read_only

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

    Attributes
    ----------
    t
        (N,) time, s; strictly increasing in a recording, stamps may be irregular.
    q, dq, ddq
        (N, n) position, velocity, acceleration, rad or m. None where not measured:
        derived in :func:`lieid_casadi.recording.process`, never on loading.
    tau
        (N, n) joint torque, N·m or N.
    temperature
        (N, n) °C.
    current
        (N, n) motor current, A.
    command
        (N, n) commanded position, rad or m.
    payload_label
        Label of the payload for each row (column ``load``).
    torque_constants
        (n) N·m/A with which ``tau`` was computed from ``current``; None if ``tau`` was recorded.
    units
        Units of the source that were converted: ``deg``, and ``ms``, ``us`` or ``ns``.
    pauses
        Stamps, s, after which the recorder paused by intention: the ends of episodes. No samples
        were lost there.
    name
        Name of the file or other source, for messages and tables.
    source_hash
        sha256 of the file's bytes, or of the arrays.
    warnings
        Warnings that were found on loading.
    """

    t: Array
    q: Array
    dq: Array | None = None
    tau: Array | None = None
    ddq: Array | None = None
    temperature: Array | None = None
    current: Array | None = None
    command: Array | None = None
    payload_label: tuple[str, ...] | None = None
    torque_constants: tuple[float, ...] | None = None
    units: tuple[str, ...] = ()
    pauses: tuple[float, ...] = ()
    name: str = ""
    source_hash: str = ""
    warnings: tuple[LieidWarning, ...] = ()

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
        rows = slice(first, last)
        fields = ("t", "q", *OPTIONAL_SIGNALS, "payload_label")
        signals: dict[str, Any] = {field: getattr(self, field) for field in fields}
        for field, values in signals.items():
            signals[field] = None if values is None else values[rows]
        return replace(self, **signals)
