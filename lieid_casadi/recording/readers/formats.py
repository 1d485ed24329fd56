"""Which file format a path means, and which part of a recording."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from lieid_casadi.errors import RecordingError

if TYPE_CHECKING:
    from lieid_casadi.recording.recording import Recording

_PART = re.compile(r"(?P<path>.+)@(?P<start>[^:@/]*):(?P<end>[^:@/]*)")


def split_part(path: str | Path) -> tuple[Path, float | None, float | None]:
    """File and ends, s, of ``FILE@T0:T1``; open ends are None."""
    match = _PART.fullmatch(str(path))
    if match is None or Path(path).exists():
        return Path(path), None, None
    ends: list[float | None] = []
    for text in (match["start"], match["end"]):
        try:
            end = float(text) if text.strip() else None
        except ValueError:
            end = np.nan
        if end is not None and not np.isfinite(end):
            raise RecordingError(
                f"{path}: found {text!r} after @, expected FILE@T0:T1 with T0, T1 in seconds"
            )
        ends.append(end)
    first, last = ends
    if first is not None and last is not None and not first < last:
        raise RecordingError(f"{path}: found {first:g} to {last:g} s, expected T0 < T1")
    return Path(match["path"]), first, last


def reader_of(file: Path) -> Callable[..., Recording]:
    """Loader for a file by its suffix: called with the file, n=, joint_names=, topic=."""
    name = file.name.lower()
    if name.endswith((".csv", ".csv.gz")):
        from lieid_casadi.recording.readers.csv_file import load_csv

        return load_csv
    if name.endswith(".npz"):
        from lieid_casadi.recording.readers.npz_file import load_npz

        return load_npz
    if name.endswith(".parquet"):
        from lieid_casadi.recording.readers.parquet_file import load_parquet

        return load_parquet
    if name.endswith((".mcap", ".bag", ".db3")) or file.is_dir():
        from lieid_casadi.recording.readers.ros_file import load_bag

        return load_bag
    if not file.exists():
        raise RecordingError(f"{file}: no such file, expected a recording")
    raise RecordingError(
        f"{file}: found suffix {file.suffix!r}, "
        "expected .csv, .csv.gz, .npz, .parquet, .mcap, .bag or a ROS 2 bag folder"
    )


def writer_of(file: Path) -> Callable[[Recording, Path], None]:
    """Writer for a file by its suffix."""
    name = file.name.lower()
    if name.endswith((".csv", ".csv.gz")):
        from lieid_casadi.recording.readers.csv_file import save_csv

        return save_csv
    if name.endswith(".npz"):
        from lieid_casadi.recording.readers.npz_file import save_npz

        return save_npz
    if name.endswith(".parquet"):
        from lieid_casadi.recording.readers.parquet_file import save_parquet

        return save_parquet
    raise RecordingError(
        f"{file}: found suffix {file.suffix!r}, expected .csv, .csv.gz, .npz or .parquet"
    )
