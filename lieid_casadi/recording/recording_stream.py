"""Recordings that are larger than the memory, read part by part."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Sequence
from functools import cached_property
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from lieid_casadi.errors import RecordingError
from lieid_casadi.recording.arrays import Array, Mask
from lieid_casadi.recording.readers.file_part import split_part
from lieid_casadi.recording.readers.part_readers import ConvertedParts, WholeFile
from lieid_casadi.recording.readers.registry import (
    INFLATE_LIMIT,
    PartReader,
    ReadOptions,
    format_of,
)
from lieid_casadi.recording.recording import Recording
from lieid_casadi.recording.sample_timing import gap_limit, sample_rate
from lieid_casadi.robot.drive import Drive

#: Number of rows in each sample of a long recording, and number of samples.
SAMPLE_ROWS, SAMPLE_PLACES = 1 << 17, 5
#: Arrays beyond this size lie in a temporary file, bytes.
SCRATCH_BYTES = 16 << 20
#: Arguments of `stream`.
STREAMED = ("torque_constants", "drives", "n", "units", "revolute", "inflate_limit")


class RecordingStream:
    """A recording in a file, of which only the time stamps are kept in memory.

    :func:`lieid_casadi.recording.process` and :func:`lieid_casadi.identify` take it in place of a
    recording; the signals that they keep have the rate of the grid, some 20 cut-offs, and lie in
    a temporary file (folder ``$TMPDIR``) where they are large.

    Parameters
    ----------
    reader
        Source of the rows.
    torque_constants
        (n,) N·m/A: currents become torques where there are none.
    drives
        (n) control laws: commanded positions become torques where there are none.
    bounds
        First row and last row (excluded); None: all rows.
    stamps
        Stamps (N,) of all rows and rows where the payload changes; None: read them.
    """

    def __init__(
        self,
        reader: PartReader,
        torque_constants: ArrayLike | None = None,
        *,
        drives: Sequence[Drive] | None = None,
        bounds: tuple[int, int] | None = None,
        stamps: tuple[Array, Sequence[int]] | None = None,
    ) -> None:
        self._reader, self._constants, self._drives = reader, torque_constants, drives
        self._stamps = reader.times() if stamps is None else stamps
        self._first, self._last = bounds or (0, len(self._stamps[0]))
        self.name = reader.name

    @property
    def title(self) -> str:
        """Name for the beginning of a message."""
        return self.name or "recording"

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
        """Samples per second, Hz: one over the median time between rows (see `sample_rate`)."""
        return sample_rate(self.t)

    @property
    def duration(self) -> float:
        """Time from the first row to the last, s."""
        return float(self.t[-1] - self.t[0]) if len(self) else 0.0

    @property
    def payload_label(self) -> tuple[str, ...] | None:
        """Label of the first row: a segment has one only."""
        return self._start.payload_label

    @property
    def torque_constants(self) -> tuple[float, ...] | None:
        """Constants (n) with which torque was computed from currents, N·m/A."""
        return self._start.torque_constants

    @property
    def units(self) -> tuple[str, ...]:
        """Units of the file that are converted."""
        return self._start.units

    def __len__(self) -> int:
        return self._last - self._first

    def rows(self, first: int, last: int) -> Recording:
        """Return rows first … last − 1 as a recording.

        Raises
        ------
        RecordingError
            NaN or Inf, time that does not increase, a file that cannot be read.
        """
        made = Recording.of_measurement(self._reader.rows(self._first + first, self._first + last))
        return made.with_torque(self._constants, self._drives)

    def segments(self) -> list[RecordingStream]:
        """Return the stretches without a gap and with one payload label."""
        limit = gap_limit(self.t)
        gaps = np.flatnonzero(np.diff(self.t) > limit) + 1 + self._first
        changes = [row for row in self._stamps[1] if self._first < row < self._last]
        edges = sorted({self._first, *gaps.tolist(), *changes, self._last})
        return [self._between(a, b) for a, b in pairwise(edges)]

    def samples(self) -> list[Recording]:
        """Return parts at five places of the longest segment, as a sample of the whole."""
        longest = max(self.segments(), key=len)
        count = min(len(longest), SAMPLE_ROWS)
        places = SAMPLE_PLACES if len(longest) > SAMPLE_PLACES * count else 1
        firsts = np.linspace(0, len(longest) - count, places).astype(int)
        return [longest.rows(int(first), int(first) + count) for first in firsts]

    def cut(self, start: float | None, end: float | None) -> RecordingStream:
        """Return the part with start ≤ t < end, s, on the recording's own clock."""
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
            self._reader,
            self._constants,
            drives=self._drives,
            bounds=(first, last),
            stamps=self._stamps,
        )

    @cached_property
    def _start(self) -> Recording:
        return self.rows(0, min(2, len(self)))


def stream(
    path: str | Path,
    *,
    torque_constants: ArrayLike | None = None,
    drives: Sequence[Drive] | None = None,
    n: int | None = None,
    units: str | Sequence[str] = (),
    revolute: Mask | None = None,
    inflate_limit: int = INFLATE_LIMIT,
) -> RecordingStream:
    """Open a recording that is read part by part: Parquet by row groups, other files whole.

    Parameters
    ----------
    path
        File; ``FILE@T0:T1`` is the part with T0 ≤ t < T1 seconds.
    torque_constants
        (n,) N·m/A: columns ``i*`` become torques where there are no ``tau*``.
    n
        Number of joints that is expected.
    drives, units, revolute, inflate_limit
        As for :meth:`Recording.load`.

    Raises
    ------
    RecordingError
        As for :meth:`Recording.load`, some of it only when a part is read.
    """
    file, start, end = split_part(path)
    if not file.exists():
        raise RecordingError(f"{file}: no such file, expected a recording")
    options = ReadOptions(n=n, inflate_limit=inflate_limit)
    read_parts = format_of(file).read_parts or WholeFile
    made = RecordingStream(ConvertedParts(read_parts(file, options), units, revolute),
                           torque_constants, drives=drives)  # fmt: skip
    if len(made) < 2 or not np.all(np.diff(made.t) > 0.0):
        made.rows(0, len(made))  # raises the error with its place
    return made if start is None and end is None else made.cut(start, end)


def load_or_stream(path: str | Path, **options: Any) -> Recording | RecordingStream:
    """Load a recording, or open a stream where its columns exceed an eighth of the memory.

    Parameters
    ----------
    path
        As for :meth:`Recording.load`.
    options
        Arguments of :meth:`Recording.load`; streamed formats number their joints, so that those
        that concern names, topics and episodes have no effect on them.
    """
    file, _, _ = split_part(path)
    decoded_bytes = format_of(file).decoded_bytes
    large = decoded_bytes is not None and file.exists() and decoded_bytes(file) > memory_bytes() / 8
    if large:
        return stream(path, **{name: options[name] for name in STREAMED if name in options})
    return Recording.load(path, **options)


def memory_bytes() -> int:
    """Return the size of the machine's memory; 8 GiB where the system does not state it."""
    try:
        return os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    except (AttributeError, ValueError, OSError):
        return 8 << 30


def scratch(shape: tuple[int, ...], dtype: Any) -> np.ndarray[Any, Any]:
    """Return an array of zeros, in a temporary file where it is large.

    Parameters
    ----------
    shape, dtype
        Of the array. The file is deleted with it.
    """
    if np.prod(shape) * np.dtype(dtype).itemsize <= SCRATCH_BYTES:
        return np.zeros(shape, dtype)
    with tempfile.TemporaryFile(prefix="lieid-casadi-") as file:
        return np.memmap(file, dtype=dtype, mode="w+", shape=shape)
