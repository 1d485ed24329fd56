"""Recordings that are larger than memory: read part by part, in time, as often as needed."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Sequence
from functools import cached_property
from itertools import pairwise
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from numpy.typing import ArrayLike

from lieid_casadi.errors import RecordingError
from lieid_casadi.recording.arrays import Array
from lieid_casadi.recording.checks.faults import require_sound
from lieid_casadi.recording.processing.sample_timing import gap_limit, sample_period
from lieid_casadi.recording.readers.formats import split_part
from lieid_casadi.recording.recording import Recording

#: Rows that are looked at where a whole recording would be, and at how many places.
SAMPLE_ROWS, SAMPLE_PLACES = 1 << 17, 5
#: Arrays beyond this size lie in a temporary file, bytes.
SCRATCH_BYTES = 16 << 20


class Reader(Protocol):
    """Where a stream's rows come from."""

    name: str

    @property
    def source_hash(self) -> str:
        """sha256 of the file's bytes."""

    def times(self) -> tuple[Array, Sequence[int]]:
        """Stamps (N,) of all rows, and the rows before which the payload's label changes."""

    def rows(self, first: int, last: int) -> Recording:
        """Rows first … last − 1; cheapest in the order of time."""


class RecordingStream:
    """A recording in a file, of which only the time stamps are kept in memory.

    :func:`lieid_casadi.recording.process` and :func:`lieid_casadi.identify` take it in place of a
    recording; what they keep has the rate of the grid, some 20 cut-offs, in a temporary file
    (folder ``$TMPDIR``) where it is large.

    Parameters
    ----------
    reader : Reader
    torque_constants
        (n,) N·m/A: currents become torques where there are none.
    """

    def __init__(
        self,
        reader: Reader,
        torque_constants: ArrayLike | None = None,
        *,
        bounds: tuple[int, int] | None = None,
        stamps: tuple[Array, Sequence[int]] | None = None,
    ) -> None:
        self._reader, self._constants = reader, torque_constants
        self._stamps = reader.times() if stamps is None else stamps
        self._first, self._last = bounds or (0, len(self._stamps[0]))
        self.name = reader.name

    @property
    def source_hash(self) -> str:
        """sha256 of the file's bytes."""
        return self._reader.source_hash

    @property
    def t(self) -> Array:
        """(N,) time, s."""
        return self._stamps[0][self._first : self._last]

    @property
    def n(self) -> int:
        """Number of joints."""
        return self._start.n

    @property
    def rate(self) -> float:
        """Samples per second: one over the median time between rows, Hz."""
        return 1.0 / sample_period(self.t)

    @property
    def duration(self) -> float:
        """Time from the first row to the last, s."""
        return float(self.t[-1] - self.t[0]) if len(self) else 0.0

    @property
    def payload_label(self) -> tuple[str, ...] | None:
        """Label of the first row: a segment has one only."""
        return self._start.payload_label

    def __len__(self) -> int:
        return self._last - self._first

    def rows(self, first: int, last: int) -> Recording:
        """Rows first … last − 1 as a recording.

        Raises
        ------
        RecordingError
            NaN or Inf, time that does not increase, a file that cannot be read.
        """
        made = self._reader.rows(self._first + first, self._first + last)
        require_sound(made)
        if self._constants is not None and made.tau is None:
            made = made.with_torque_constants(self._constants)
        return made

    def segments(self) -> list[RecordingStream]:
        """Stretches without a gap and with one payload label."""
        limit = gap_limit(self.t)
        gaps = np.flatnonzero(np.diff(self.t) > limit) + 1 + self._first
        changes = [row for row in self._stamps[1] if self._first < row < self._last]
        edges = sorted({self._first, *gaps.tolist(), *changes, self._last})
        return [self._between(a, b) for a, b in pairwise(edges)]

    def samples(self) -> list[Recording]:
        """Parts that stand for the whole, at five places of its longest segment."""
        longest = max(self.segments(), key=len)
        count = min(len(longest), SAMPLE_ROWS)
        places = SAMPLE_PLACES if len(longest) > SAMPLE_PLACES * count else 1
        firsts = np.linspace(0, len(longest) - count, places).astype(int)
        return [longest.rows(int(first), int(first) + count) for first in firsts]

    def cut(self, start: float | None, end: float | None) -> RecordingStream:
        """Part with start ≤ t < end, s, on the recording's own clock."""
        low, high = -np.inf if start is None else start, np.inf if end is None else end
        first, last = self._first + np.searchsorted(self.t, [low, high])
        if last - first < 2:
            raise RecordingError(
                f"{self.name}: {last - first} rows in that part, "
                f"expected some of {self.t[0]:g} to {self.t[-1]:g} s"
            )
        return self._between(int(first), int(last))

    def _between(self, first: int, last: int) -> RecordingStream:
        return RecordingStream(
            self._reader, self._constants, bounds=(first, last), stamps=self._stamps
        )

    @cached_property
    def _start(self) -> Recording:
        return self.rows(0, min(2, len(self)))


def stream(
    path: str | Path, *, torque_constants: ArrayLike | None = None, n: int | None = None
) -> RecordingStream:
    """A recording that is read part by part: Parquet by row groups, other files one at a time.

    Parameters
    ----------
    path
        File; ``FILE@T0:T1`` is the part with T0 ≤ t < T1 seconds.
    torque_constants
        (n,) N·m/A: columns ``i*`` become torques where there are no ``tau*``.
    n
        Number of joints that is expected.

    Raises
    ------
    RecordingError
        As for :meth:`Recording.load`, some of it only when a part is read.
    """
    file, start, end = split_part(path)
    if not file.exists():
        raise RecordingError(f"{file}: no such file, expected a recording")
    reader: Reader
    if file.name.lower().endswith(".parquet"):
        from lieid_casadi.recording.readers.parquet_parts import ParquetParts

        reader = ParquetParts(file, n)
    else:
        reader = _WholeFile(file, n)
    made = RecordingStream(reader, torque_constants)
    if len(made) < 2 or not np.all(np.diff(made.t) > 0.0):
        require_sound(made.rows(0, len(made)))
    return made if start is None and end is None else made.cut(start, end)


def load_or_stream(
    path: str | Path, *, torque_constants: ArrayLike | None = None, n: int | None = None
) -> Recording | RecordingStream:
    """A recording in memory, or a stream of a Parquet file above an eighth of the memory."""
    file, _, _ = split_part(path)
    if file.name.lower().endswith(".parquet") and file.exists():
        from lieid_casadi.recording.readers.parquet_parts import decoded_bytes

        if decoded_bytes(file) > memory_bytes() / 8:
            return stream(path, torque_constants=torque_constants, n=n)
    return Recording.load(path, torque_constants=torque_constants, n=n)


def memory_bytes() -> int:
    """The machine's memory; 8 GB where it does not say."""
    try:
        return os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    except (AttributeError, ValueError, OSError):
        return 8 << 30


class _WholeFile:
    """A file that can only be read whole: the last one that was asked for is kept."""

    _kept: tuple[Path, Recording] | None = None

    def __init__(self, file: Path, n: int | None) -> None:
        self._file, self._n = file, n
        self.name = self._load().name

    @property
    def source_hash(self) -> str:
        return self._load().source_hash

    def times(self) -> tuple[Array, Sequence[int]]:
        recording = self._load()
        labels = np.asarray(recording.payload_label or [""] * len(recording))
        return recording.t, (np.flatnonzero(labels[1:] != labels[:-1]) + 1).tolist()

    def rows(self, first: int, last: int) -> Recording:
        return self._load().rows(first, last)

    def _load(self) -> Recording:
        if _WholeFile._kept is None or _WholeFile._kept[0] != self._file:
            _WholeFile._kept = None
            _WholeFile._kept = self._file, Recording.load(self._file, n=self._n)
        return _WholeFile._kept[1]


def scratch(shape: tuple[int, ...], dtype: Any) -> np.ndarray[Any, Any]:
    """An array of zeros, in a temporary file where it is large; gone with the array."""
    if np.prod(shape) * np.dtype(dtype).itemsize <= SCRATCH_BYTES:
        return np.zeros(shape, dtype)
    with tempfile.TemporaryFile(prefix="lieid-casadi-") as file:
        return np.memmap(file, dtype=dtype, mode="w+", shape=shape)
