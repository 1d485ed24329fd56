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
    """Package version and recordings that a fit was computed from."""

    version: str
    recordings: tuple[Source, ...]
