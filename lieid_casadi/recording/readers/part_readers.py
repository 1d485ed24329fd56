"""Part readers of files that can only be read whole, and with a conversion of units."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from lieid_casadi.errors import RecordingError
from lieid_casadi.recording.arrays import Array, Mask
from lieid_casadi.recording.faults import require_sound
from lieid_casadi.recording.measurement import Measurement
from lieid_casadi.recording.readers.registry import PartReader, ReadOptions, read_measurement
from lieid_casadi.recording.units import convert_units, unit_factors

#: Path, device, inode, size and time of change of each file.
FileState = tuple[tuple[str, int, int, int, int], ...]


class ConvertedParts:
    """A part reader whose rows are converted to SI units."""

    def __init__(
        self, reader: PartReader, units: str | Sequence[str], revolute: Mask | None
    ) -> None:
        self._reader, self._units, self._revolute = reader, units, revolute
        self.name = reader.name

    @property
    def source_hash(self) -> str:
        """sha256 of the file's bytes."""
        return self._reader.source_hash

    def times(self) -> tuple[Array, Sequence[int]]:
        """See `PartReader`."""
        t, changes = self._reader.times()
        return t * unit_factors(self._units)[0], changes

    def rows(self, first: int, last: int) -> Measurement:
        """See `PartReader`."""
        return convert_units(self._reader.rows(first, last), self._units, self._revolute)


class WholeFile:
    """A file that can only be read whole; the content of the last one that was used is kept.

    A file that was rewritten is read again by new streams; older streams refuse it, because
    their stamps are those of the former content.
    """

    _kept: tuple[tuple[FileState, ReadOptions], Measurement] | None = None

    def __init__(self, file: Path, options: ReadOptions) -> None:
        self._file, self._options = file, options
        self._state = _file_state(file)
        self.name = self._content().name

    @property
    def source_hash(self) -> str:
        """sha256 of the file's bytes."""
        return self._content().source_hash

    def times(self) -> tuple[Array, Sequence[int]]:
        """See `PartReader`."""
        content = self._content()
        labels = np.asarray(content.payload_label or [""] * len(content))
        return content.t, (np.flatnonzero(labels[1:] != labels[:-1]) + 1).tolist()

    def rows(self, first: int, last: int) -> Measurement:
        """See `PartReader`."""
        return self._content().rows(first, last)

    def _content(self) -> Measurement:
        if _file_state(self._file) != self._state:
            raise RecordingError(f"{self._file}: the file was changed while it was being read")
        key = self._state, self._options
        if WholeFile._kept is None or WholeFile._kept[0] != key:
            WholeFile._kept = None
            content = read_measurement(self._file, self._options)
            require_sound(content)
            WholeFile._kept = key, content
        return WholeFile._kept[1]


def _file_state(file: Path) -> FileState:
    """Return identity, size and time of change of a file, or of the files in a folder."""
    files = sorted(p for p in file.rglob("*") if p.is_file()) if file.is_dir() else [file]
    try:
        found = [(str(p.absolute()), p.stat()) for p in files]
    except OSError as error:
        raise RecordingError(f"{file}: cannot be read ({error.strerror or error})") from error
    return tuple((path, s.st_dev, s.st_ino, s.st_size, s.st_mtime_ns) for path, s in found)
