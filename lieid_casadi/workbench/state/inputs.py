"""What is open on a page: robot or fit, recordings, and what is left out of them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

Role = Literal["train", "test"]
Mode = Literal["missing", "changed"]


@dataclass(frozen=True)
class RecordingInput:
    """A recording that is open: its path, or ``FILE@T0:T1``, and what it is used for."""

    path: str
    role: Role


@dataclass(frozen=True)
class WorkbenchInputs:
    """What is open on a page.

    Attributes
    ----------
    robot : str
        Path or bundled name; empty if nothing is open.
    fit : str
        Path of a fit in place of the robot, empty without one.
    mode : str
        ``missing``: the model is fitted to the training recordings. ``changed``: the fit is kept,
        and all recordings were measured after it.
    recordings : tuple of RecordingInput
    effects : tuple of str
        Of the first model; of a fit in place of the robot if empty.
    torque_constants, units : str
        As on the command line.
    options : tuple of (str, str)
        Further options of the command line: name without dashes, and text (``stiffness``, ``12``).
    tip : str
    lock : tuple of str
    """

    robot: str = ""
    fit: str = ""
    mode: Mode = "missing"
    recordings: tuple[RecordingInput, ...] = ()
    effects: tuple[str, ...] = ()
    torque_constants: str = ""
    units: str = ""
    options: tuple[tuple[str, str], ...] = ()
    tip: str = ""
    lock: tuple[str, ...] = ()

    @property
    def lacking(self) -> tuple[str, str] | None:
        """What is missing, and whether it is about the ``model`` or the ``recordings``."""
        if not (self.robot or self.fit):
            return "no robot; expected a file, or a bundled name such as panda", "model"
        if not self.recordings:
            return "no recordings; expected at least one", "recordings"
        if self.mode == "missing" and not self.paths("train"):
            return "no recording to fit; set at least one of them to “fit”", "recordings"
        return None

    def paths(self, role: Role) -> list[str]:
        """Return the paths of the recordings with this role."""
        return [r.path for r in self.recordings if r.role == role]


@dataclass(frozen=True)
class ExcludedRange:
    """A stretch of one recording that is left out, from ``start`` to ``end`` seconds."""

    recording: int
    start: float
    end: float


def kept_parts(
    excluded: Sequence[ExcludedRange], recording: int
) -> list[tuple[float | None, float | None]]:
    """Return start and end of the stretches of one recording that are used, s.

    None is the recording's own start or end.
    """
    ranges = sorted((e.start, e.end) for e in excluded if e.recording == recording)
    parts: list[tuple[float | None, float | None]] = []
    start: float | None = None
    for low, high in ranges:
        if start is None or low > start:
            parts.append((start, low))
        start = high if start is None else max(start, high)
    return [*parts, (start, None)]
