"""Recordings as Parquet (extra ``[parquet]``), columns as in a CSV."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from lieid_casadi.atomic_file import atomic_binary
from lieid_casadi.recording.measurement import Measurement
from lieid_casadi.recording.readers.columns import layout_warnings, read_layout
from lieid_casadi.recording.readers.parquet_parts import (
    ParquetParts,
    decoded_bytes,
    import_pyarrow,
    require_bounded_size,
)
from lieid_casadi.recording.readers.registry import (
    ReadOptions,
    RecordingFormat,
    hash_of_file,
    library_errors,
)
from lieid_casadi.recording.readers.tables import columns_of, measurement_of_columns


def read_parquet(file: Path, options: ReadOptions) -> Measurement:
    """Read a Parquet file; nulls are refused as NaN, columns with other names are not read.

    Raises
    ------
    RecordingError
        Not Parquet, a missing column, or one that does not hold numbers.
    MissingDependency
        pyarrow is not installed.
    """
    _, parquet = import_pyarrow(file)
    require_bounded_size(file, options.inflate_limit)
    with library_errors(file, "a Parquet file"):
        content = parquet.ParquetFile(file)
        names = content.schema_arrow.names
        layout = read_layout(names, str(file), options.n)
        columns = {}
        for name in layout.used(names):  # one by one, or all are in memory twice
            column = content.read(columns=[name]).column(0)
            columns[name] = np.asarray(column.to_numpy(zero_copy_only=False))
    return replace(
        measurement_of_columns(columns, str(file), options.n),
        name=file.name,
        source_hash=hash_of_file(file),
        warnings=layout_warnings(layout, file.name),
    )


def write_parquet(measurement: Measurement, file: Path) -> None:
    """Write a Parquet file."""
    pyarrow, parquet = import_pyarrow(file)
    table = pyarrow.table({name: np.asarray(x) for name, x in columns_of(measurement).items()})
    with atomic_binary(file) as out:
        parquet.write_table(table, out)


FORMAT = RecordingFormat(
    suffixes=(".parquet",),
    read=read_parquet,
    write=write_parquet,
    read_parts=ParquetParts,
    decoded_bytes=decoded_bytes,
)
