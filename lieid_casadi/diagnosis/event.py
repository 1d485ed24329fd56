"""A stretch of a recording that is left out of a diagnosis, and the reason in one sentence."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal

from lieid_casadi.identification.recording_checks import Source

Kind = Literal["contact", "fault", "standstill"]


@dataclass(frozen=True)
class Event:
    """A stretch of a recording that is left out of a diagnosis.

    Attributes
    ----------
    kind : str
        ``contact``: a transient torque that the motion does not explain. ``fault``: samples that
        the recorder lost or repeated. ``standstill``: joints that do not move enough.
    recording : Source
    start, end : float
        On the recording's clock, s.
    joints : tuple of int
        From 0.
    peak : float
        Largest error of these joints, N·m.
    sentence : str
        What was found, where, and with which consequence.
    force : tuple of float or None
        Force on the tool (3,), base axes, N, that explains a contact.
    """

    kind: Kind
    recording: Source
    start: float
    end: float
    joints: tuple[int, ...]
    peak: float
    sentence: str
    force: tuple[float, float, float] | None = None

    def to_dict(self) -> dict[str, Any]:
        """Return plain data for JSON, with joints from 1."""
        return {
            "kind": self.kind,
            "recording": self.recording.name,
            "from": self.start,
            "to": self.end,
            "joints": [joint + 1 for joint in self.joints],
            "peak": self.peak,
            "force": None if self.force is None else list(self.force),
            "sentence": self.sentence,
        }
