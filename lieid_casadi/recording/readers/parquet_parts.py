"""Parts of a Parquet file, batch after batch (extra ``[parquet]``)."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from lieid_casadi.errors import MissingDependency, RecordingError
from lieid_casadi.recording.arrays import Array
from lieid_casadi.recording.measurement import Measurement
from lieid_casadi.recording.readers.columns import LABEL, read_layout
from lieid_casadi.recording.readers.registry import (
    ReadOptions,
    beyond_limit,
    hash_of_file,
    library_errors,
)
from lieid_casadi.recording.readers.tables import measurement_of_columns

BATCH = 1 << 15  # rows decoded at once
#: Largest ratio of decoded to stored size in files of measured signals.
LARGEST_RATIO = 50


class ParquetParts:
    """Rows of a Parquet file; read in the order of time, each is decoded once.

    Parameters
    ----------
    file
        The Parquet file.
    options
        Number of joints that is expected.

    Raises
    ------
    RecordingError
        Not Parquet, or a missing column.
    MissingDependency
        pyarrow is not installed.
    """

    def __init__(self, file: Path, options: ReadOptions) -> None:
        self._pyarrow, parquet = import_pyarrow(file)
        self.name, self._path, self._n = file.name, file, options.n
        require_bounded_size(file, options.inflate_limit)
        with library_errors(file, "a Parquet file"):
            self._file = parquet.ParquetFile(file)
            names = self._file.schema_arrow.names
        self._layout = read_layout(names, str(file), options.n)
        self._time = names[self._layout.time]
        self._used = self._layout.used(names)
        meta = self._file.metadata
        groups = [meta.row_group(k).num_rows for k in range(meta.num_row_groups)]
        self._starts = np.concatenate([[0], np.cumsum(groups)]).astype(int)
        self._batches: Iterator[Any] = iter(())
        self._held: list[tuple[int, Any]] = []
        self._next = 0

    @property
    def source_hash(self) -> str:
        """sha256 of the file's bytes."""
        return hash_of_file(self._path)

    def times(self) -> tuple[Array, Sequence[int]]:
        """See `PartReader`."""
        with library_errors(self._path, "a Parquet file"):
            t, row = np.empty(self._starts[-1]), 0
        changes: list[int] = []
        label: str | None = None
        wanted = [self._time] + ([LABEL] if self._layout.label is not None else [])
        for batch in self._read(0, wanted):
            t[row : row + len(batch)] = _numbers(batch.column(self._time), str(self._path))
            if LABEL in wanted:
                labels = [str(x) for x in batch.column(LABEL).to_pylist()]
                before = [labels[0] if label is None else label, *labels[:-1]]
                pairs = enumerate(zip(before, labels, strict=True))
                changes += [row + k for k, (a, b) in pairs if a != b]
                label = labels[-1]
            row += len(batch)
        return t, changes

    def rows(self, first: int, last: int) -> Measurement:
        """See `PartReader`."""
        if not self._held or first < self._held[0][0] or first > self._next + BATCH:
            group = int(np.searchsorted(self._starts, first, side="right")) - 1
            self._batches = self._read(group)
            self._held, self._next = [], int(self._starts[group])
        while self._next < last:
            batch = next(self._batches)
            self._held.append((self._next, batch))
            self._next += len(batch)
            self._held = [(row, part) for row, part in self._held if row + len(part) > first]
        start = self._held[0][0]
        table = self._pyarrow.Table.from_batches([part for _, part in self._held])
        table = table.slice(first - start, last - first)
        columns = {
            name: table.column(name).to_numpy(zero_copy_only=False) for name in table.column_names
        }
        title = f"{self._path} (rows {first + 1} to {last})"
        return measurement_of_columns(columns, title, self._n)

    def _read(self, group: int, columns: Sequence[str] | None = None) -> Iterator[Any]:
        """Yield the batches from a row group on; group by group, or all of them stay in memory."""
        with library_errors(self._path, "a Parquet file"):
            for k in range(group, len(self._starts) - 1):
                batches = self._file.iter_batches(
                    BATCH, row_groups=[k], columns=columns or self._used
                )
                yield from (batch for batch in batches if len(batch))


def require_bounded_size(file: Path, limit: int) -> None:
    """Refuse a file that decodes to more than the limit, bytes, and to far more than its own size.

    Measured signals hardly compress, so that files of real recordings pass whatever their size.

    Raises
    ------
    RecordingError
        States the limit and how to raise it.
    """
    size = decoded_bytes(file)
    if size > limit and size > LARGEST_RATIO * file.stat().st_size:
        raise beyond_limit(file, limit)


def decoded_bytes(file: Path) -> int:
    """Return the size of a file's columns in memory; 0 for one that is not Parquet."""
    pyarrow, parquet = import_pyarrow(file)
    try:
        meta = parquet.read_metadata(file)
    except (pyarrow.ArrowException, OSError, ValueError):  # UnicodeDecodeError: damaged names
        return 0
    return 8 * int(meta.num_rows) * int(meta.num_columns)


def import_pyarrow(file: Path) -> tuple[Any, Any]:
    """Return pyarrow and its reader of Parquet.

    Raises
    ------
    MissingDependency
        pyarrow is not installed.
    """
    try:
        import pyarrow
        import pyarrow.parquet as parquet
    except ImportError as error:
        raise MissingDependency(
            f"{file}: Parquet needs pyarrow: pip install 'lieid-casadi[parquet]'"
        ) from error
    return pyarrow, parquet


def _numbers(column: Any, where: str) -> Array:
    try:
        return np.asarray(column.to_numpy(zero_copy_only=False), dtype=np.float64)
    except (TypeError, ValueError, OverflowError):
        raise RecordingError(f"{where}: column t: expected numbers") from None
