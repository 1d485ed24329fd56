"""Origin of a fit: the package's version and the recordings."""

from __future__ import annotations

from dataclasses import dataclass

from lieid_casadi.recording import Recording


@dataclass(frozen=True)
class Source:
    """A recording that a result was computed from: its name and the SHA-256 of its data."""

    name: str
    sha256: str

    @classmethod
    def of(cls, recording: Recording) -> Source:
        """Return name and hash of a recording."""
        return cls(recording.name, recording.source_hash)

    def to_dict(self) -> dict[str, str]:
        """Return the source for JSON: ``{name, sha256}``."""
        return {"name": self.name, "sha256": self.sha256}


@dataclass(frozen=True)
class Provenance:
    """What a fit was computed from.

    Attributes
    ----------
    version : str
        Of the package.
    recordings : tuple of Source
    torque_constants : tuple of float or None
        (n) N·m/A, of recordings of motor currents; None if torque was recorded.
    units : tuple of str
        Units of the recordings' files other than SI: ``deg``, and ``ms``, ``us`` or ``ns``.
    """

    version: str
    recordings: tuple[Source, ...]
    torque_constants: tuple[float, ...] | None = None
    units: tuple[str, ...] = ()
