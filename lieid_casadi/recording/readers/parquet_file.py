"""Recordings as Parquet (extra ``[parquet]``), columns as in a CSV."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from lieid_casadi.atomic_file import atomic_binary
from lieid_casadi.errors import MissingDependency, RecordingError
from lieid_casadi.recording.readers.tables import columns_of, recording_from_columns
from lieid_casadi.recording.recording import Recording


def load_parquet(
    file: Path,
    *,
    n: int | None = None,
    joint_names: Sequence[str] | None = None,
    topic: str | None = None,
) -> Recording:
    """Read a Parquet file; nulls are refused as NaN.

    Raises
    ------
    RecordingError
        Not Parquet, a missing column, or one that does not hold numbers.
    MissingDependency
        pyarrow is not installed.
    """
    pyarrow, parquet = import_pyarrow(file)
    with open(file, "rb") as binary:
        digest = hashlib.file_digest(binary, "sha256").hexdigest()
    try:
        content = parquet.ParquetFile(file)
        columns = {}
        for name in content.schema_arrow.names:  # one by one, or all are in memory twice
            column = content.read(columns=[name]).column(0)
            columns[name] = np.asarray(column.to_numpy(zero_copy_only=False))
    except (pyarrow.ArrowInvalid, OSError) as error:
        reason = str(error).splitlines()[0]
        raise RecordingError(f"{file}: not a Parquet file ({reason})") from error
    recording = recording_from_columns(columns, str(file), n)
    return replace(recording, name=file.name, source_hash=digest)


def save_parquet(recording: Recording, file: Path) -> None:
    """Write a Parquet file."""
    pyarrow, parquet = import_pyarrow(file)
    table = pyarrow.table({name: np.asarray(x) for name, x in columns_of(recording).items()})
    with atomic_binary(file) as out:
        parquet.write_table(table, out)


def import_pyarrow(file: Path) -> tuple[Any, Any]:
    """Return pyarrow and its reader of Parquet."""
    try:
        import pyarrow
        import pyarrow.parquet as parquet
    except ImportError as error:
        raise MissingDependency(
            f"{file}: Parquet needs pyarrow: pip install 'lieid-casadi[parquet]'"
        ) from error
    return pyarrow, parquet
