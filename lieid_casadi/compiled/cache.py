"""Compiled libraries on disk, kept between runs of a program.

A library runs with the user's rights when it is loaded. It is therefore used only if its file and
folder belong to the user and nobody else may write to them. Files are written under another name,
synchronized and renamed: each is whole, and two processes may build the same one at once.
"""

from __future__ import annotations

import logging
import os
import stat
import tempfile
from functools import cache
from pathlib import Path

logger = logging.getLogger("lieid_casadi")

KEEP = 2000  # libraries of about 60 kB; beyond it the oldest are deleted


def cache_folder() -> Path | None:
    """Return the folder of compiled libraries, None if the environment names none.

    It is ``$LIEID_CACHE_DIR``, else ``lieid-casadi`` in ``$XDG_CACHE_HOME`` or ``~/.cache``. A
    relative ``XDG_CACHE_HOME`` is ignored, as its specification asks, and so is a home directory
    that is unknown or relative.
    """
    stated = os.environ.get("LIEID_CACHE_DIR")
    if stated:
        return Path(stated).absolute()
    home = Path(os.path.expanduser("~"))
    for base in (Path(os.environ.get("XDG_CACHE_HOME", "")), home / ".cache"):
        if base.is_absolute():
            return base / "lieid-casadi"
    return None


def find(key: str) -> Path | None:
    """Return the path of a key's library if it is there and safe to load, else None."""
    folder = cache_folder()
    for place in (*([folder] if folder else []), *_private_folders):
        path = place / f"{key}.so"
        if path.exists() and not unsafe(place) and not unsafe(path):
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
    """Write a library to the cache, or to a private temporary folder if the cache is not usable.

    Raises `OSError`: neither can be written.
    """
    folder = cache_folder()
    reason = "the home directory is unknown"
    if folder is not None:
        try:
            folder.mkdir(parents=True, exist_ok=True, mode=0o700)
            reason = unsafe(folder)
            if not reason:
                path = _write(folder, key, library)
                _prune(folder)
                return path
        except OSError as error:
            reason = error.strerror or str(error)
    return _write(_private_folder(folder, reason), key, library)


def discard(path: Path) -> None:
    """Delete a library that cannot be used."""
    try:
        path.unlink(missing_ok=True)
    except OSError as error:
        logger.debug("%s cannot be deleted: %s", path, error)


def _write(folder: Path, key: str, library: bytes) -> Path:
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
    return path


def _prune(folder: Path) -> None:
    libraries = list(folder.glob("*.so"))
    if len(libraries) <= KEEP:
        return
    dated = []
    for path in libraries:
        try:
            dated.append((path.stat().st_mtime, path))
        except OSError:  # another process pruned it
            continue
    for _, path in sorted(dated)[: len(dated) - KEEP // 2]:
        path.unlink(missing_ok=True)


_private_folders: list[Path] = []
_open_folders: list[tempfile.TemporaryDirectory[str]] = []  # deleted when the program ends


@cache
def _private_folder(unusable: Path | None, reason: str) -> Path:
    folder = tempfile.TemporaryDirectory(prefix="lieid-casadi-")  # mode 700
    _open_folders.append(folder)
    _private_folders.append(Path(folder.name))
    logger.warning(
        "cache folder %s is not used (%s): compiled models are kept for this run only; make it a "
        "folder of your own that only you can write to, or set LIEID_CACHE_DIR to one",
        unusable or "~/.cache/lieid-casadi",
        reason,
    )
    return Path(folder.name)
