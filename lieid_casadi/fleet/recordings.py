"""Recordings of a fleet: listed and read through fsspec, from paths or URLs."""

from __future__ import annotations

import contextlib
import tempfile
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from datetime import UTC, date, datetime
from pathlib import Path
from re import Pattern
from typing import Any, TypeVar

from lieid_casadi.errors import FleetError, MissingDependency, of_extra
from lieid_casadi.messages import reason_of

T = TypeVar("T")
FOLDER_FILES = ("metadata.yaml", "meta/info.json")  # of recordings that are folders
VERSION_KEYS = ("ETag", "etag", "md5Hash", "VersionId")


@dataclass(frozen=True)
class RecordingFile:
    """A recording in a store."""

    location: str  # path or URL
    stamp: str  # changes with the file: size, and the store's hash or the time of change
    modified: datetime | None  # UTC


def list_recordings(pattern: str) -> list[RecordingFile]:
    """Return the files of a path pattern or URL, sorted by name; none if no file matches."""
    system, path = _file_system(pattern)
    local, several = is_local(pattern), any(c in path for c in "*?[")

    def listed() -> Mapping[str, Mapping[str, Any]]:
        if several:
            return dict(system.glob(path, detail=True))
        return {path: system.info(path)}

    found = []
    for name, info in sorted(_attempt(listed, pattern).items()):
        is_folder = local and any((Path(name) / each).is_file() for each in FOLDER_FILES)
        if is_folder or info.get("type") != "directory":
            location = name if local else _url(pattern, system, name)
            version = next((str(info[key]) for key in VERSION_KEYS if info.get(key)), "")
            try:
                modified = system.modified(name)
            except NotImplementedError:
                modified = None
            stamp = f"{info.get('size')}:{version or modified}"
            found.append(RecordingFile(location, stamp, modified))
    if not found and not several:
        raise FleetError(
            f"{pattern}: a folder; expected a file, or a pattern such as {pattern}/*.csv"
        )
    return found


@contextlib.contextmanager
def local_copy(location: str) -> Iterator[Path]:
    """Path of a recording on this machine; of a remote one a copy that is removed afterwards."""
    if is_local(location):
        if not Path(location).exists():
            raise FleetError(f"{location}: no such file")
        yield Path(location)
        return
    system, path = _file_system(location)
    with tempfile.TemporaryDirectory(prefix="lieid-fleet-") as folder:
        copy = Path(folder) / path.rpartition("/")[2]
        _attempt(lambda: system.get_file(path, str(copy)), location)
        yield copy


def night_of(file: RecordingFile, pattern: Pattern[str] | None) -> date:
    """Return the date of a recording: that in its path, or that of the file's last change (UTC)."""
    if pattern is None:
        if file.modified is None:
            raise FleetError(
                f"{file.location}: the store states no time of change; expected a date in the "
                "path and the key 'night' in the fleet file"
            )
        return file.modified.astimezone(UTC).date()
    match = pattern.search(file.location)
    if match is None:
        raise FleetError(f"{file.location}: 'night' ({pattern.pattern}) does not match this path")
    text = match["date"]
    try:
        stated = datetime.fromisoformat(text)
    except ValueError:
        raise FleetError(
            f"{file.location}: found {text!r} as date, expected ISO 8601 such as 2026-11-20"
        ) from None
    return (stated.astimezone(UTC) if stated.tzinfo else stated).date()


def _file_system(location: str) -> tuple[Any, str]:
    with of_extra("fleet", "fleets need fsspec; install it with"):
        import fsspec
    try:
        system, path = fsspec.core.url_to_fs(location)
    except ImportError as error:  # such as s3fs for s3://
        raise MissingDependency(f"{location}: {reason_of(error)}") from None
    except Exception as error:
        raise FleetError(f"{location}: {reason_of(error)}") from error
    return system, str(path)


def _attempt(action: Callable[[], T], location: str) -> T:
    """Return the result of an action on a store; what it raises becomes one line."""
    try:
        return action()
    except FileNotFoundError:
        raise FleetError(f"{location}: no such file") from None
    except Exception as error:
        raise FleetError(f"{location}: cannot be read ({reason_of(error)})") from error


def is_local(location: str) -> bool:
    """Whether a location is a path and not a URL."""
    return "://" not in location and "::" not in location


def _url(pattern: str, system: Any, name: str) -> str:
    inner, chained, outer = pattern.partition("::")
    if chained:
        return f"{inner.partition('://')[0]}://{name}::{outer}"
    return str(system.unstrip_protocol(name))
