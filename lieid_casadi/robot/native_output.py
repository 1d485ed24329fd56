"""Capture of what native libraries write on the process's standard output and error."""

from __future__ import annotations

import os
import sys
import tempfile
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from threading import Lock
from typing import BinaryIO

LONGEST = 100_000  # bytes that are kept
_lock = Lock()  # the descriptors belong to the process


@dataclass
class NativeOutput:
    """``text`` holds what was written, once the capture has ended."""

    text: str = ""


@contextmanager
def captured() -> Iterator[NativeOutput]:
    """Redirect the file descriptors 1 and 2 of the process while a native library works.

    Libraries such as urdfdom print their complaints there, past Python's ``sys.stderr``. Where no
    temporary file can be made they are discarded.
    """
    output = NativeOutput()
    with _lock, _temporary_file() as file, ExitStack() as restore:
        for stream in (sys.stdout, sys.stderr):
            if stream is not None:
                stream.flush()
        restore.callback(_read, file, output)
        for descriptor in (1, 2):
            try:
                copy = os.dup(descriptor)
            except OSError:  # closed, as in a service without a terminal
                continue
            restore.callback(os.close, copy)
            restore.callback(os.dup2, copy, descriptor)
            os.dup2(file.fileno(), descriptor)
        yield output


def _temporary_file() -> BinaryIO:
    try:
        return tempfile.TemporaryFile()
    except OSError:
        return open(os.devnull, "r+b")


def _read(file: BinaryIO, output: NativeOutput) -> None:
    file.seek(0)
    output.text = file.read(LONGEST).decode("utf-8", errors="replace")
