"""Files: output that is replaced as a whole or left as it was, and input that can be read."""

from __future__ import annotations

import contextlib
import errno
import io
import os
import secrets
import shutil
import stat
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import BinaryIO

from lieid_casadi.errors import OutputError

PREFIX, SUFFIX = ".lieid-", ".part"  # of temporary files and folders


def require_regular(path: str | Path) -> None:
    """Refuse to read what is no regular file, such as a pipe that nobody writes to."""
    if "\0" in str(path):
        raise OSError(errno.EINVAL, "its name has a null character")
    if not stat.S_ISREG(os.stat(path).st_mode):
        folder = "is a folder" if os.path.isdir(path) else "is a pipe or a device"
        raise OSError(errno.EINVAL, f"{folder}; expected a regular file")


def read_limited(
    path: str | Path, largest: int, error: Callable[[str], Exception], expected: str
) -> bytes:
    """Return the content of a regular file; ``error`` of one that is missing or too large."""
    try:
        require_regular(path)
        with open(path, "rb") as file:
            data = file.read(largest + 1)
    except FileNotFoundError:
        raise error(f"{path}: no such file; expected {expected}") from None
    except OSError as problem:
        raise error(f"{path}: cannot be read: {problem.strerror}") from None
    if len(data) > largest:
        raise error(f"{path}: larger than {largest >> 20} MB; expected {expected}")
    return data


@contextlib.contextmanager
def atomic_binary(path: str | Path, *, private: bool = False) -> Iterator[BinaryIO]:
    """Binary file that takes its place only after it was written and closed without error.

    Symbolic links are followed and missing folders made. An existing regular file is replaced
    atomically and keeps its mode and owner. Devices, pipes and streams are written through.
    """
    check_file(path)
    with reported(path):
        status = _status(path)
        if status is not None and _written_through(status):
            content = io.BytesIO()
            yield content
            _write_through(path, status, content.getbuffer())
            return
        target = Path(os.path.realpath(path))
        if private:
            target.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
        temporary_file = _temporary_file(target.parent, mode=0o600 if private else 0o666)
        with created_folders(target.parent), temporary_file as (temporary, file):
            yield file
            file.flush()
            os.fsync(file.fileno())
            if status is not None and not private:
                with contextlib.suppress(OSError):  # only a privileged user may give files away
                    os.fchown(file.fileno(), status.st_uid, status.st_gid)
                os.fchmod(file.fileno(), stat.S_IMODE(status.st_mode))
            os.replace(temporary, target)


def check_file(path: str | Path) -> None:
    """Refuse a path that a file cannot be written to; nothing is changed."""
    if not str(path):
        raise OutputError("the path of an output is empty; expected the name of a file")
    with reported(path):
        status = _status(path)
        if status is not None and stat.S_ISDIR(status.st_mode):
            raise OutputError(f"{path}: is a folder; expected a file to write")
        if status is not None and not os.access(path, os.W_OK):
            raise OutputError(f"{path}: cannot be written: no permission")
        if status is None or not _written_through(status):
            check_parent(path)


def check_parent(path: str | Path) -> None:
    """Refuse a path in whose folder, or in what exists of it, nothing can be made."""
    folder = Path(os.path.realpath(path)).parent
    while not folder.exists() and folder != folder.parent:
        folder = folder.parent
    if not folder.is_dir():
        raise OutputError(f"{path}: cannot be written: {folder} is not a folder")
    if not os.access(folder, os.W_OK | os.X_OK):
        raise OutputError(f"{path}: cannot be written: no permission in {folder}")


@contextlib.contextmanager
def reported(path: str | Path) -> Iterator[None]:
    """Turn an error of the operating system into one line that names the output."""
    try:
        yield
    except BrokenPipeError:
        raise  # the reader has gone; the command line ends quietly
    except OSError as error:
        reason = error.strerror or str(error)
        raise OutputError(f"{path}: cannot be written: {reason}") from error


@contextlib.contextmanager
def created_folders(folder: Path) -> Iterator[None]:
    """Make a folder and those above it; after an error, remove those that were made."""
    missing: list[Path] = []
    above = folder
    while not above.exists():
        missing.append(above)
        above = above.parent
    try:
        folder.mkdir(parents=True, exist_ok=True)
        yield
    except BaseException:
        for made in missing:
            with contextlib.suppress(OSError):
                made.rmdir()
        raise


@contextlib.contextmanager
def temporary_folder(parent: Path) -> Iterator[Path]:
    """Folder that is removed at the end, unless it was renamed."""
    folder = _temporary_name(parent)
    folder.mkdir()
    try:
        yield folder
    finally:
        shutil.rmtree(folder, ignore_errors=True)


def is_temporary(name: str) -> bool:
    """Return whether a name is that of a temporary file of this program."""
    return name.startswith(PREFIX) and name.endswith(SUFFIX)


@contextlib.contextmanager
def _temporary_file(folder: Path, *, mode: int) -> Iterator[tuple[Path, BinaryIO]]:
    path = _temporary_name(folder)
    handle = os.open(path, os.O_RDWR | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC, mode)
    try:
        with os.fdopen(handle, "w+b") as file:
            yield path, file
    except BaseException:
        with contextlib.suppress(OSError):
            os.unlink(path)
        raise


def _temporary_name(folder: Path) -> Path:
    return folder / f"{PREFIX}{secrets.token_hex(8)}{SUFFIX}"


def _status(path: str | Path) -> os.stat_result | None:
    try:
        return os.stat(path)
    except (FileNotFoundError, NotADirectoryError):
        return None


def _written_through(status: os.stat_result) -> bool:
    return not stat.S_ISREG(status.st_mode) or _standard_stream(status) is not None


def _standard_stream(status: os.stat_result) -> int | None:
    """Return the number of the standard output or error stream that is this file."""
    for stream in (1, 2):
        with contextlib.suppress(OSError):
            if os.path.samestat(os.fstat(stream), status):
                return stream
    return None


def _write_through(path: str | Path, status: os.stat_result, content: memoryview) -> None:
    stream = _standard_stream(status)
    if stream is not None:
        sys.stdout.flush()
    with open(path if stream is None else os.dup(stream), "wb") as file:
        file.write(content)
