"""Origin of a fit: the package's version and the recordings."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Source:
    """A recording that a result was computed from: its name and the SHA-256 of its data."""

    name: str
    sha256: str


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
