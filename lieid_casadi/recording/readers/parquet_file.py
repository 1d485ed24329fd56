"""Recordings as Parquet (extra ``[parquet]``), columns as in a CSV."""

from __future__ import annotations

import math
import os
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from lieid_casadi.arrays import Array, Indices
from lieid_casadi.atomic_file import atomic_binary
from lieid_casadi.errors import LargeFileWarning, of_extra
from lieid_casadi.recording.measurement import Measurement
from lieid_casadi.recording.readers import registry
from lieid_casadi.recording.readers.columns import columns_of, measurement_of_columns, read_layout
from lieid_casadi.recording.sample_timing import GAP_PERIODS

#: Largest ratio of decoded to stored size in files of measured signals.
LARGEST_RATIO = 50
#: Part of the memory that a recording may take.
MEMORY_PART = 1 / 8
BATCH = 1 << 15  # rows decoded at once


def read_parquet(file: Path, options: registry.ReadOptions) -> Measurement:
    """Read a Parquet file; of one beyond an eighth of the memory, means of rows or a part."""
    _, parquet = import_pyarrow(file)
    require_bounded_size(file)
    large = decoded_bytes(file) > MEMORY_PART * memory_bytes()
    with registry.library_errors(file, "a Parquet file"):
        content = parquet.ParquetFile(file)
        stored = content.schema_arrow.names
        given = options.n, options.columns, options.joint_names
        layout = read_layout(stored, str(file), *given, title=file.name)
        used, warnings = layout.used(stored), layout.warnings
        if large:
            label = None if layout.label is None else stored[layout.label]
            columns, step = _decimated(content, used, label, options.part)
            if step > 1:
                text = (
                    f"{file.name}: larger than the memory allows: each row is the mean of {step} "
                    f"rows of the file; {file.name}@T0:T1 reads a part at its full rate"
                )
                warnings += (LargeFileWarning(text),)
        else:  # one by one, or all are in memory twice
            columns = {name: _values(content.read(columns=[name]).column(0)) for name in used}
    columns = dict(zip(layout.used(), columns.values(), strict=True))
    return replace(
        measurement_of_columns(columns, str(file), options.n),
        name=file.name,
        source_hash=registry.hash_of_file(file),
        warnings=warnings,
    )


def write_parquet(measurement: Measurement, file: Path) -> None:
    """Write a Parquet file."""
    pyarrow, parquet = import_pyarrow(file)
    table = pyarrow.table({name: np.asarray(x) for name, x in columns_of(measurement).items()})
    with atomic_binary(file) as out:
        parquet.write_table(table, out)


FORMAT = registry.RecordingFormat(suffixes=(".parquet",), read=read_parquet, write=write_parquet)


def require_bounded_size(file: Path) -> None:
    """Refuse a file that decodes to far more than its own size, as no measured signals do."""
    size = decoded_bytes(file)
    if size > registry.INFLATE_LIMIT and size > LARGEST_RATIO * file.stat().st_size:
        raise registry.beyond_limit(file, registry.INFLATE_LIMIT)


def decoded_bytes(file: Path) -> int:
    """Return the size of a file's columns in memory; 0 for one that is not Parquet."""
    pyarrow, parquet = import_pyarrow(file)
    try:
        meta = parquet.read_metadata(file)
    except (pyarrow.ArrowException, OSError, ValueError):  # UnicodeDecodeError: damaged names
        return 0
    return 8 * int(meta.num_rows) * int(meta.num_columns)


def memory_bytes() -> int:
    """Return the size of the machine's memory; 8 GiB where the system does not state it."""
    try:
        return os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    except (AttributeError, ValueError, OSError):
        return 8 << 30


def import_pyarrow(file: Path) -> tuple[Any, Any]:
    """Return pyarrow and its reader of Parquet."""
    with of_extra("parquet", f"{file}: Parquet needs pyarrow"):
        import pyarrow
        import pyarrow.parquet as parquet
    return pyarrow, parquet


def _decimated(
    content: Any, used: list[str], label: str | None, part: tuple[float, float]
) -> tuple[dict[str, Any], int]:
    """Return columns of the rows within a part, and of how many rows their values are means."""
    t = _values(content.read(columns=used[:1]).column(0))
    rows = int(np.sum((t >= part[0]) & (t < part[1])))
    step = math.ceil(8 * rows * len(used) / (MEMORY_PART * memory_bytes()))
    read: dict[str, list[Any]] = {name: [] for name in used}
    for group in range(content.metadata.num_row_groups):  # or all of them stay in memory
        for batch in content.iter_batches(BATCH, row_groups=[group], columns=used):
            t = _values(batch.column(used[0]))
            inside = (t >= part[0]) & (t < part[1])
            if not inside.any():
                continue
            labels = None if label is None else _values(batch.column(label))[inside]
            first = _block_starts(t[inside], labels, step)
            for name in used:
                x = _values(batch.column(name))[inside]
                read[name].append(x[first] if name == label else _means(x, first))
    return {name: np.concatenate(parts) for name, parts in read.items()}, step


def _block_starts(t: Array, label: Any, step: int) -> Indices:
    """Return the first rows of blocks of ``step`` rows, none across a gap or another payload."""
    steps = np.diff(t)
    new = np.ones(len(t), dtype=bool)
    new[1:] = steps > GAP_PERIODS * np.median(steps) if len(steps) else False
    if label is not None:
        new[1:] |= label[1:] != label[:-1]
    row = np.arange(len(t))
    begin = np.maximum.accumulate(np.where(new, row, 0))
    return np.flatnonzero((row - begin) % step == 0)


def _means(x: Any, first: Indices) -> Array:
    counts = np.diff([*first, len(x)])
    return np.asarray(np.add.reduceat(np.asarray(x, dtype=float), first) / counts)


def _values(column: Any) -> Any:
    return np.asarray(column.to_numpy(zero_copy_only=False))
