"""Compiled libraries on disk, kept between runs of a program.

A library runs with the user's rights when it is loaded. It is therefore used only if its file and
folder belong to the user and nobody else may write to them. Files are written under another name,
synchronized and renamed: each is whole, and two processes may build the same one at once.
"""

from __future__ import annotations

import errno
import logging
import os
import stat
import tempfile
from contextlib import suppress
from functools import cache
from pathlib import Path

logger = logging.getLogger("lieid_casadi")

KEEP = 2000  # libraries of about 60 kB; beyond it the oldest are deleted


def cache_folder() -> Path:
    """Return the folder of compiled libraries.

    A relative ``XDG_CACHE_HOME`` is ignored, as its specification asks; without a home directory it
    is a folder of the user's own among the temporary files.
    """
    stated = os.environ.get("LIEID_CACHE_DIR")
    if stated:
        return Path(stated).absolute()
    home = Path(os.path.expanduser("~"))
    for base in (Path(os.environ.get("XDG_CACHE_HOME", "")), home / ".cache"):
        if base.is_absolute():
            return base / "lieid-casadi"
    return _temporary_folder()


def _temporary_folder() -> Path:
    return Path(tempfile.gettempdir(), f"lieid-casadi-{os.geteuid()}")


def find(key: str) -> Path | None:
    """Return the path of a key's library if it is there and safe to load, else None."""
    for folder in (cache_folder(), _temporary_folder()):
        path = folder / f"{key}.so"
        if path.exists() and not unsafe(folder) and not unsafe(path):
            return path
    return None


def unsafe(path: Path) -> str:
    """Return why a file or folder must not be loaded from, empty if it may."""
    try:
        status = path.stat()
    except OSError as error:
        return error.strerror or str(error)
    if status.st_uid != os.geteuid():
        return f"it belongs to user {status.st_uid}"
    if status.st_mode & (stat.S_IWGRP | stat.S_IWOTH):
        return f"others may write to it (mode {stat.S_IMODE(status.st_mode):o})"
    return ""


def store(key: str, library: bytes) -> Path:
    """Write a library to the cache, or among the temporary files if the cache is not usable."""
    folder = cache_folder()
    try:
        return _write(folder, key, library)
    except OSError as error:
        _notice(folder, error.strerror or str(error))
    return _write(_temporary_folder(), key, library)


@cache
def _notice(folder: Path, reason: str) -> None:
    logger.warning(
        "cache folder %s is not used (%s): compiled models are kept in %s; make it a folder of "
        "your own that only you can write to, or set LIEID_CACHE_DIR to one",
        folder, reason, _temporary_folder(),
    )  # fmt: skip


def discard(path: Path) -> None:
    """Delete a library that cannot be used."""
    with suppress(OSError):
        path.unlink(missing_ok=True)


def _write(folder: Path, key: str, library: bytes) -> Path:
    folder.mkdir(parents=True, exist_ok=True, mode=0o700)
    reason = unsafe(folder)
    if reason:
        raise PermissionError(errno.EACCES, reason)
    path = folder / f"{key}.so"
    handle, name = tempfile.mkstemp(prefix=f".{key[:16]}-", dir=folder)
    try:
        with os.fdopen(handle, "wb") as file:
            file.write(library)
            file.flush()
            os.fsync(file.fileno())
        os.chmod(name, 0o700)
        os.replace(name, path)
    except BaseException:
        Path(name).unlink(missing_ok=True)
        raise
    libraries = list(folder.glob("*.so"))
    if len(libraries) > KEEP:
        dated = sorted(libraries, key=lambda p: p.stat().st_mtime if p.exists() else 0.0)
        for old in dated[: len(libraries) - KEEP // 2]:
            old.unlink(missing_ok=True)
    return path
