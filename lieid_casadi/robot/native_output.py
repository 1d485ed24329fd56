"""Capture of what native libraries write on the process's standard output and error."""

from __future__ import annotations

import os
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from threading import Lock

_lock = Lock()  # the descriptors belong to the process


@dataclass
class NativeOutput:
    """``text`` holds what was written, once the capture has ended."""

    text: str = ""


@contextmanager
def captured() -> Iterator[NativeOutput]:
    """Redirect the file descriptors 1 and 2 of the process while a native library works.

    Libraries such as urdfdom print their complaints there, past Python's ``sys.stderr``.
    """
    output = NativeOutput()
    with _lock, tempfile.TemporaryFile() as file:
        for stream in (sys.stdout, sys.stderr):
            if stream is not None:
                stream.flush()
        kept = {}
        for descriptor in (1, 2):
            try:
                kept[descriptor] = os.dup(descriptor)
            except OSError:  # closed, as in a service without a terminal
                continue
            os.dup2(file.fileno(), descriptor)
        try:
            yield output
        finally:
            for descriptor, copy in kept.items():
                os.dup2(copy, descriptor)
                os.close(copy)
            file.seek(0)
            output.text = file.read(100_000).decode("utf-8", errors="replace")
