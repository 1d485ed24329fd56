"""Recordings as functions take them: one, or several."""

from __future__ import annotations

from collections.abc import Iterable
from os import PathLike
from typing import TypeVar

from lieid_casadi.errors import RecordingError
from lieid_casadi.recording.recording import Recording
from lieid_casadi.recording.recording_stream import RecordingStream

R = TypeVar("R", bound=Recording | RecordingStream)


def listed(recordings: R | Iterable[R]) -> list[R]:
    """Return one recording or several as a list.

    Raises
    ------
    RecordingError
        One of them is something else, such as the path of a file.
    """
    if isinstance(recordings, Iterable) and not isinstance(recordings, str):
        result = list(recordings)
    else:
        result = [recordings]
    for given in result:
        if isinstance(given, str | PathLike):
            path = str(given)
            raise RecordingError(f"got the path {path!r}; expected Recording.load({path!r})")
        if not isinstance(given, Recording | RecordingStream):
            raise RecordingError(f"got a {type(given).__name__}; expected a Recording")
    return result
