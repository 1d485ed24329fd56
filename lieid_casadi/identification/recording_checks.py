"""Recordings of a fit: which they were, and checks against a model before they are used."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from lieid_casadi.errors import (
    EffectError,
    IdentificationError,
    LieidWarning,
    ModelError,
    TorqueConstantsWarning,
)
from lieid_casadi.model import Model
from lieid_casadi.recording import Recording
from lieid_casadi.recording.recording import listed


def check_recordings(model: Model, recordings: Sequence[Recording]) -> None:
    """Raise if recordings lack what the model needs: joints, torque, temperature."""
    if not recordings:
        raise IdentificationError("no recordings given; expected at least one")
    for recording in recordings:
        name = recording.name or "recording"
        check_joints(model, recording)
        if recording.tau is None:
            raise ModelError(
                f"{name}: no torque; expected columns tau1…tau{model.n}, "
                "or currents with --torque-constants"
            )


def check_joints(model: Model, recording: Recording) -> None:
    """Raise `ModelError` or `EffectError` if a recording lacks joints or temperatures."""
    listed(recording)  # refuses the path of a file
    name = recording.name or "recording"
    if recording.n != model.n:
        raise ModelError(f"{name}: {recording.n} joints; robot {model.robot.name!r} has {model.n}")
    warm = [p.label for p in model.placements if "temperature" in p.effect.signals]
    if warm and recording.temperature is None:
        raise EffectError(
            f"{name}: {warm[0]} needs temperature; expected columns temp1…temp{model.n}"
        )
    commanded = [p.label for p in model.placements if p.effect.commanded]
    if commanded and (recording.command is None or model.robot.drives is None):
        raise EffectError(
            f"{name}: {commanded[0]} needs commanded positions and a drive law; expected columns "
            f"qcmd1…qcmd{model.n} and --stiffness or --servo"
        )


def check_torque_constants(provenance: Provenance, recording: Recording) -> list[LieidWarning]:
    """Return a warning if currents became torques by other constants than those of a fit.

    Every error, load and mass then scales with the ratio of the constants.
    """
    fitted, used = provenance.torque_constants, recording.torque_constants
    if fitted is None or used is None or fitted == used:
        return []
    differing = ", ".join(
        f"joint {j + 1} {k:g} (fit: {own:g})"
        for j, (k, own) in enumerate(zip(used, fitted, strict=True))
        if k != own
    )
    return [
        TorqueConstantsWarning(
            f"{recording.name or 'recording'}: torque constants differ from those of the fit: "
            f"{differing} N·m/A; use those of the fit, or fit again"
        )
    ]


_NUMBER = r"((?:[-+]?\d+(?:\.\d+)?(?:[eE][-+]?\d+)?)?)"
_PART = re.compile(rf"(?:@| episodes ){_NUMBER}:{_NUMBER}$")


@dataclass(frozen=True)
class Source:
    """A recording that a result was computed from: its name and the SHA-256 of its data."""

    name: str
    sha256: str

    @classmethod
    def of(cls, recording: Recording) -> Source:
        """Return name and hash of a recording."""
        return cls(recording.name, recording.source_hash)

    def overlaps(self, other: Source) -> bool:
        """Return whether two recordings share samples: the same data with overlapping parts."""
        if not self.sha256 or self.sha256 != other.sha256:
            return False
        ends = []
        for name in (self.name, other.name):  # of a part, s or episodes; infinite if none is stated
            start, end = found.groups() if (found := _PART.search(name)) else ("", "")
            ends.append((float(start or -np.inf), float(end or np.inf)))
        return max(start for start, _ in ends) < min(end for _, end in ends)

    def to_dict(self) -> dict[str, str]:
        """Return the source for JSON: ``{name, sha256}``."""
        return {"name": self.name, "sha256": self.sha256}


@dataclass(frozen=True)
class Provenance:
    """What a fit was computed from."""

    version: str  # of the package
    recordings: tuple[Source, ...]
    #: (n): N·m/A, of recordings of motor currents; None if torque was recorded
    torque_constants: tuple[float, ...] | None = None
    #: units of the recordings' files other than SI: ``deg``, and ``ms``, ``us`` or ``ns``
    units: tuple[str, ...] = ()
    #: columns of the recordings' files that were assigned to signals, such as ``tau2=tau3``
    columns: tuple[str, ...] = ()
    #: options that corrected the recordings, such as ``--joint-order 1 3 2``
    corrections: tuple[str, ...] = ()

    def contains(self, source: Source) -> bool:
        """Return whether a recording shares samples with one of these."""
        return self.number(source) is not None

    def number(self, source: Source) -> int | None:
        """Return the number, from 0, of a recording: the same, or the first that shares samples."""
        found = [k for k, each in enumerate(self.recordings) if source.overlaps(each)]
        return min(found, key=lambda k: self.recordings[k] != source, default=None)
