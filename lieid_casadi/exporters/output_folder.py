"""Folders that are either there in full or not at all."""

from __future__ import annotations

import os
import shutil
import tempfile
from collections.abc import Mapping
from pathlib import Path

from lieid_casadi.errors import ExportError


def check_folder(folder: str | Path, *, force: bool) -> Path:
    """Return the folder's full path, if it may be written.

    Raises
    ------
    ExportError
        It is a file, or has content that is not to be replaced, or cannot be written.
    """
    target = Path(folder).resolve()
    if target.exists() and not target.is_dir():
        raise ExportError(f"{folder}: is a file; expected a folder")
    if not force and target.is_dir() and any(target.iterdir()):
        raise ExportError(f"{folder}: not empty; expected a new folder, or --force to replace it")
    above = target.parent
    while not above.exists() and above != above.parent:
        above = above.parent
    if not above.is_dir():
        raise ExportError(f"{folder}: cannot be written: {above} is not a folder")
    if not os.access(above, os.W_OK | os.X_OK):
        raise ExportError(f"{folder}: cannot be written: no permission in {above}")
    return target


def write_folder(
    folder: str | Path, files: Mapping[str, bytes], *, force: bool = False
) -> tuple[Path, ...]:
    """Write a folder's files beside it first, then put all in place at once.

    Parameters
    ----------
    files : mapping
        Name → content.
    force : bool
        Replace a folder with content, as a whole.

    Raises
    ------
    ExportError
        As `check_folder`, or the system refuses to write.
    """
    target = check_folder(folder, force=force)
    fresh: Path | None = None
    try:
        target.parent.mkdir(parents=True, exist_ok=True)
        fresh = Path(tempfile.mkdtemp(dir=target.parent, prefix=f".{target.name}."))
        for name, content in files.items():
            (fresh / name).write_bytes(content)
        # mkdtemp makes private folders; a result has the permissions of any other new folder
        mask = os.umask(0)
        os.umask(mask)
        fresh.chmod(0o777 & ~mask)
        _put_in_place(fresh, target)
    except OSError as error:
        raise ExportError(f"{folder}: cannot be written: {error.strerror}") from None
    finally:
        if fresh is not None:
            shutil.rmtree(fresh, ignore_errors=True)
    return tuple(target / name for name in files)


def _put_in_place(fresh: Path, target: Path) -> None:
    """Give a folder its name; what had it before goes only then."""
    old = fresh.with_name(f"{fresh.name}.old")
    if target.exists():
        target.rename(old)
    try:
        fresh.rename(target)
    except OSError:
        if old.exists():
            old.rename(target)
        raise
    shutil.rmtree(old, ignore_errors=True)
