"""Compiled libraries on disk, between runs of a program.

A library is followed by its checksum: a file that a crash or a full disk cut short is not loaded
but built again. Files come into being under another name and are moved into place, so that two
processes may build the same one at once.
"""

from __future__ import annotations

import hashlib
import logging
import os
import tempfile
from functools import cache
from pathlib import Path

logger = logging.getLogger("lieid_casadi")

MARK = b"lieid-casadi:1:"
TAIL = len(MARK) + hashlib.sha256().digest_size
KEEP = 2000  # libraries of some 60 kB; the oldest go


def cache_folder() -> Path:
    """Return ``$LIEID_CACHE_DIR``, else lieid-casadi in ``$XDG_CACHE_HOME`` or ~/.cache."""
    stated = os.environ.get("LIEID_CACHE_DIR")
    if stated:
        return Path(stated)
    base = os.environ.get("XDG_CACHE_HOME")
    return (Path(base) if base else Path(os.path.expanduser("~"), ".cache")) / "lieid-casadi"


def find(key: str) -> Path | None:
    """Return the whole library of a key, or None."""
    for folder in (cache_folder(), *_spare_folders):
        path = folder / f"{key}.so"
        if is_whole(path):
            return path
    return None


def is_whole(path: Path) -> bool:
    """Whether a library is there with all its bytes."""
    try:
        data = path.read_bytes()
    except OSError:
        return False
    return len(data) > TAIL and data[-TAIL:] == _tail(data[:-TAIL])


def store(key: str, library: bytes) -> Path:
    """Put a library into the cache, or into a temporary folder if the cache is not writable.

    Raises
    ------
    OSError
        Neither can be written.
    """
    folder = cache_folder()
    try:
        folder.mkdir(parents=True, exist_ok=True, mode=0o700)
        path = _write(folder, key, library)
        _prune(folder)
        return path
    except OSError as error:
        spare = _spare_folder(folder, error.strerror or str(error))
        return _write(spare, key, library)


def _write(folder: Path, key: str, library: bytes) -> Path:
    path = folder / f"{key}.so"
    handle, name = tempfile.mkstemp(prefix=f".{key[:16]}-", dir=folder)
    try:
        with os.fdopen(handle, "wb") as file:
            file.write(library + _tail(library))
        os.chmod(name, 0o700)
        os.replace(name, path)
    except BaseException:
        Path(name).unlink(missing_ok=True)
        raise
    return path


def _tail(library: bytes) -> bytes:
    return MARK + hashlib.sha256(library).digest()


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


_spare_folders: list[Path] = []
_open_folders: list[tempfile.TemporaryDirectory[str]] = []  # removed when the program ends


@cache
def _spare_folder(unwritable: Path, reason: str) -> Path:
    folder = tempfile.TemporaryDirectory(prefix="lieid-casadi-")
    _open_folders.append(folder)
    _spare_folders.append(Path(folder.name))
    logger.warning(
        "cache folder %s is not writable (%s): compiled models last for this run only; "
        "make it writable or set LIEID_CACHE_DIR",
        unwritable,
        reason,
    )
    return Path(folder.name)
