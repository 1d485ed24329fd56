"""Output folders: made as a whole, or their own files replaced and all others kept."""

from __future__ import annotations

import contextlib
import json
import os
from collections.abc import Iterator, Mapping
from pathlib import Path, PurePosixPath

from lieid_casadi.atomic_file import (
    atomic_binary,
    check_parent,
    created_folders,
    is_temporary,
    reported,
    temporary_folder,
)
from lieid_casadi.errors import OutputError

MANIFEST = "lieid-manifest.json"
PROGRAM = "lieid-casadi"


def check_folder(folder: str | Path, *, force: bool = False) -> Path:
    """Return the folder's real path, if it may be written; nothing is changed."""
    with reported(folder):
        target = Path(os.path.realpath(folder))
        if target.exists() and not target.is_dir():
            raise OutputError(f"{folder}: is a file; expected a folder")
        if target.is_dir() and not all(is_temporary(name) for name in os.listdir(target)):
            _check_replaceable(folder, target, force=force)
        check_parent(folder)
        if target.is_dir() and not os.access(target, os.W_OK | os.X_OK):
            raise OutputError(f"{folder}: cannot be written: no permission")
        return target


@contextlib.contextmanager
def output_folder(folder: str | Path, *, force: bool = False) -> Iterator[Path]:
    """Temporary folder whose files are put into ``folder`` at the end, if there was no error.

    A folder that does not exist appears as a whole. In an existing one, the files that its
    manifest lists are replaced or removed, each atomically, and all others are kept.
    """
    target = check_folder(folder, force=force)
    exists = target.is_dir()
    parent = target if exists else target.parent
    with reported(folder), created_folders(parent), temporary_folder(parent) as fresh:
        yield fresh
        files = [p for p in fresh.rglob("*") if not p.is_dir() and p != fresh / MANIFEST]
        names = sorted(p.relative_to(fresh).as_posix() for p in files)
        for name in names:
            _synchronize(fresh / name)
        if exists:
            _merge(fresh, target, names)
        else:
            _write_manifest(fresh, names)
            fresh.rename(target)


def write_folder(
    folder: str | Path, files: Mapping[str, bytes], *, force: bool = False
) -> tuple[Path, ...]:
    """Write the files of a folder, as `output_folder`; return their paths."""
    with output_folder(folder, force=force) as fresh:
        for name, content in files.items():
            path = fresh / name
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_bytes(content)
    return tuple(Path(folder) / name for name in files)


def listed_files(folder: Path) -> frozenset[str] | None:
    """Return the relative names in a folder's manifest; None without a manifest."""
    try:
        content = json.loads((folder / MANIFEST).read_text(encoding="utf-8"))
        names = content["files"] if content["program"] == PROGRAM else None
    except (OSError, ValueError, KeyError, TypeError, RecursionError):
        return None
    if not isinstance(names, list) or not all(isinstance(name, str) for name in names):
        return None
    # a name that leads out of the folder is not one that this program wrote
    return frozenset(name for name in names if _is_inside(name))


def _is_inside(name: str) -> bool:
    path = PurePosixPath(name)
    return bool(path.parts) and not path.is_absolute() and ".." not in path.parts


def _check_replaceable(folder: str | Path, target: Path, *, force: bool) -> None:
    """Refuse a folder whose content may not be replaced."""
    if listed_files(target) is None:
        raise OutputError(
            f"{folder}: not empty and not written by lieid (no {MANIFEST}); "
            "expected a new or empty folder"
        )
    if not force:
        raise OutputError(
            f"{folder}: not empty; expected a new folder, or --force to replace the files that "
            f"its {MANIFEST} lists"
        )


def _synchronize(path: Path) -> None:
    handle = os.open(path, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


def _write_manifest(folder: Path, names: list[str]) -> None:
    content = {"program": PROGRAM, "files": names}
    with atomic_binary(folder / MANIFEST) as file:
        file.write((json.dumps(content, indent=1) + "\n").encode())


def _merge(fresh: Path, target: Path, names: list[str]) -> None:
    """Put files into an existing folder; remove those of its manifest that are not among them."""
    old = listed_files(target) or frozenset()
    for name in names:
        _check_free(target, name, listed=name in old)
    # until all is done the manifest lists both, so that a killed run can be repeated
    _write_manifest(target, sorted(old.union(names)))
    for name in names:
        (target / name).parent.mkdir(parents=True, exist_ok=True)
        os.replace(fresh / name, target / name)
    for name in old.difference(names):
        _remove(target, name)
    _write_manifest(target, names)


def _check_free(target: Path, name: str, *, listed: bool) -> None:
    """Refuse to replace what the manifest does not list, or to write outside of the folder."""
    path = target / name
    if not path.parent.resolve().is_relative_to(target):
        raise OutputError(f"{path.parent}: leads out of the output folder; expected a folder")
    if path.is_dir() or (os.path.lexists(path) and not listed):
        raise OutputError(
            f"{path}: not written by lieid (not in {MANIFEST}); move it or choose another folder"
        )


def _remove(target: Path, name: str) -> None:
    path = target / name
    if not path.parent.resolve().is_relative_to(target) or path.is_dir():
        return
    path.unlink(missing_ok=True)
    for folder in path.relative_to(target).parents[:-1]:
        with contextlib.suppress(OSError):  # it has other files
            (target / folder).rmdir()
