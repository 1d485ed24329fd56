"""The file formats of recordings: each is one module of this package with a ``FORMAT``."""

from __future__ import annotations

import contextlib
import hashlib
import importlib
import pkgutil
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np

from lieid_casadi.arrays import Array
from lieid_casadi.atomic_file import require_regular
from lieid_casadi.errors import LieidError, RecordingError
from lieid_casadi.messages import reason_of
from lieid_casadi.recording.measurement import Measurement

#: Bytes that a compressed file may inflate to.
INFLATE_LIMIT = 1 << 30


@dataclass(frozen=True, kw_only=True)
class ReadOptions:
    """Options of every reader; a reader ignores those that its format has no use for."""

    n: int | None = None  # joints that are expected
    joint_names: tuple[str, ...] | None = None  # of bags and datasets, in the robot's order
    topic: str | None = None  # of bags
    episodes: tuple[int, int | None] = (0, None)  # of datasets: the first, and the end (excluded)
    calibration: str | None = None  # of datasets: a file, or limits
    position_limits: Array | None = None  # (n, 2) for limits, rad
    degrees: bool = False  # whether angles are stated to be in degrees; the caller converts
    part: tuple[float, float] = (-np.inf, np.inf)  # in the file's unit of time
    columns: tuple[tuple[str, str], ...] = ()  # names of the file format, and columns


@dataclass(frozen=True, kw_only=True)
class RecordingFormat:
    """A file format."""

    suffixes: tuple[str, ...]  # lower case
    read: Callable[[Path, ReadOptions], Measurement]
    folder: Callable[[Path], bool] | None = None  # whether a folder is in this format
    write: Callable[[Measurement, Path], None] | None = None  # None for formats that are only read


@cache
def recording_formats() -> tuple[RecordingFormat, ...]:
    """Return the ``FORMAT`` of every module of this package that defines one."""
    package = __name__.rpartition(".")[0]
    folder = [str(Path(__file__).parent)]
    names = sorted(module.name for module in pkgutil.iter_modules(folder))
    modules = [importlib.import_module(f"{package}.{name}") for name in names]
    return tuple(module.FORMAT for module in modules if hasattr(module, "FORMAT"))


def format_of(file: Path) -> RecordingFormat:
    """Return the format of a file by its suffix, or of a folder."""
    for made in recording_formats():
        in_folder = made.folder is not None and file.is_dir() and made.folder(file)
        if in_folder or (made.suffixes and file.name.lower().endswith(made.suffixes)):
            return made
    if not file.exists():
        raise RecordingError(f"{file}: no such file, expected a recording")
    if file.is_dir():
        raise RecordingError(
            f"{file}: found a folder, expected one with metadata.yaml (ROS 2 bag) or "
            "meta/info.json (LeRobot dataset), or a file"
        )
    suffixes = [suffix for made in recording_formats() for suffix in made.suffixes]
    raise RecordingError(
        f"{file}: found suffix {file.suffix!r}, "
        f"expected {', '.join(suffixes)} or the folder of a ROS 2 bag or of a LeRobot dataset"
    )


def read_measurement(file: Path, options: ReadOptions) -> Measurement:
    """Read a file in the format that its name states."""
    if "\0" in str(file):
        raise RecordingError(f"{str(file)!r}: found a null character in the name of a file")
    made = format_of(file)
    if not file.exists():
        raise RecordingError(f"{file}: no such file, expected a recording")
    if options.columns and made.write is None:
        raise RecordingError(f"{file}: columns can be stated for CSV, NPZ and Parquet only")
    try:
        for part in file.rglob("*") if file.is_dir() else [file]:
            if not part.is_dir():
                require_regular(part)
        return made.read(file, options)
    except OSError as error:
        raise RecordingError(f"{file}: cannot be read ({error.strerror or error})") from error
    except MemoryError as error:
        raise RecordingError(f"{file}: needs more memory than is available") from error


def write_measurement(measurement: Measurement, file: Path) -> None:
    """Write a file in the format that its name states, atomically."""
    writers = {s: made.write for made in recording_formats() for s in made.suffixes if made.write}
    write = next((writers[s] for s in writers if file.name.lower().endswith(s)), None)
    if write is None:
        raise RecordingError(f"{file}: found suffix {file.suffix!r}, expected {', '.join(writers)}")
    write(measurement, file)


@contextlib.contextmanager
def library_errors(file: Path | str, expected: str) -> Iterator[None]:
    """Turn every exception of a library that decodes a file into one RecordingError.

    What a library raises of a damaged file is not documented; too little memory is no damage.
    """
    try:
        yield
    except (LieidError, MemoryError):
        raise
    except Exception as error:
        raise RecordingError(f"{file}: not {expected} ({reason_of(error)})") from error


def hash_of_file(file: Path) -> str:
    """Return the sha256 of a file, or of a folder's files in the order of their names."""
    if not file.is_dir():
        with file.open("rb") as binary:
            return hashlib.file_digest(binary, "sha256").hexdigest()
    digest = hashlib.sha256()
    for part in sorted(p for p in file.rglob("*") if p.is_file()):
        digest.update(part.read_bytes())
    return digest.hexdigest()


def beyond_limit(file: Path, limit: int) -> RecordingError:
    """Return the error of a compressed file that inflates beyond the limit, bytes."""
    return RecordingError(
        f"{file}: inflates to more than {limit >> 20} MiB; if the file is what you expect, store "
        "it uncompressed, or in parts"
    )
