"""A part of a report: its heading, its template, its data."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True)
class Section:
    """One part of a report.

    Attributes
    ----------
    title : str
        Heading; empty for none.
    template : str
        File in ``report/sections`` that shows ``data``.
    data : mapping
        What the template names. Strings are escaped there: names of joints and recordings
        come from strangers.
    folded : bool
        Shown as a heading that opens on a click.
    """

    title: str
    template: str
    data: Mapping[str, Any]
    folded: bool = False
