"""Recordings as functions take them: one, or several."""

from __future__ import annotations

from collections.abc import Sequence
from os import PathLike
from typing import TypeVar

from lieid_casadi.errors import RecordingError
from lieid_casadi.recording.recording import Recording
from lieid_casadi.recording.recording_stream import RecordingStream

R = TypeVar("R", bound=Recording | RecordingStream)


def listed(recordings: R | Sequence[R]) -> list[R]:
    """Return one recording or several as a list.

    Raises
    ------
    RecordingError
        One of them is something else, such as the path of a file.
    """
    if isinstance(recordings, Recording | RecordingStream | str | PathLike):
        recordings = [recordings]
    if not isinstance(recordings, Sequence):
        raise RecordingError(f"got a {type(recordings).__name__}; expected a Recording, or several")
    for given in recordings:
        if isinstance(given, str | PathLike):
            path = str(given)
            raise RecordingError(f"got the path {path!r}; expected Recording.load({path!r})")
        if not isinstance(given, Recording | RecordingStream):
            raise RecordingError(f"got a {type(given).__name__}; expected a Recording")
    return list(recordings)
