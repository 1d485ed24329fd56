"""Lines of a text file, plain or gzipped, with limits of the inflated size and of their length."""

from __future__ import annotations

import gzip
import io
import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import IO, TYPE_CHECKING

from lieid_casadi.errors import RecordingError
from lieid_casadi.recording.readers.registry import beyond_limit

if TYPE_CHECKING:
    from _typeshed import WriteableBuffer

#: Longest line, characters; some 100,000 columns.
LONGEST_LINE = 1 << 22


def numbered_lines(file: Path, inflate_limit: int) -> Iterator[tuple[int, str]]:
    """Yield number (from 1) and text of each line that is not blank.

    Parameters
    ----------
    file
        Gzipped if its name ends in ``.gz``.
    inflate_limit
        Bytes that a gzipped file may inflate to.

    Raises
    ------
    RecordingError
        Binary data, a damaged gzip file, or a limit that is exceeded.
    """
    with file.open("rb") as raw:
        binary: IO[bytes] = raw
        if file.name.lower().endswith(".gz"):
            inflated = gzip.GzipFile(fileobj=raw)
            error = beyond_limit(file, inflate_limit)
            binary = io.BufferedReader(_BoundedStream(inflated, inflate_limit, error), 1 << 18)
        text = io.TextIOWrapper(binary, encoding="utf-8-sig")
        number = 0
        while line := _next_line(text, file, number + 1):
            number += 1
            if line.strip():
                yield number, line.rstrip("\r\n")


def _next_line(text: IO[str], file: Path, number: int) -> str:
    try:
        line = text.readline(LONGEST_LINE)
    except UnicodeDecodeError:
        line = "\0"
    except (gzip.BadGzipFile, EOFError, zlib.error) as error:
        raise RecordingError(
            f"{file}: not a complete gzip file ({error}); expected gzip, or the suffix .csv"
        ) from error
    if "\0" in line:
        raise RecordingError(f"{file}: found binary data, expected a CSV")
    if len(line) >= LONGEST_LINE:
        raise RecordingError(
            f"{file}: line {number}: found more than {LONGEST_LINE} characters, expected a CSV"
        )
    return line


class _BoundedStream(io.RawIOBase):
    """A binary stream that raises an error beyond a number of bytes."""

    def __init__(self, source: gzip.GzipFile, limit: int, error: RecordingError) -> None:
        super().__init__()
        self._source, self._left, self._error = source, limit, error

    def readable(self) -> bool:
        return True

    def readinto(self, buffer: WriteableBuffer) -> int:
        count = self._source.readinto(buffer)
        self._left -= count
        if self._left < 0:
            raise self._error
        return count
