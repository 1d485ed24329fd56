"""A part of a report: its heading, its template, its data."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from lieid_casadi.tables import Table


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
        Variables of the template. Text is escaped there, since names of joints and recordings
        come from files of others.
    folded : bool
        Shown as a heading that opens with a click.
    """

    title: str
    template: str
    data: Mapping[str, Any]
    folded: bool = False


def table_section(
    title: str,
    *tables: Table,
    sentences: Sequence[str] = (),
    facts: Sequence[tuple[str, str]] = (),
    titles: bool = False,
    links: Mapping[str, str] | None = None,
    folded: bool = False,
) -> Section:
    """Return a section of tables.

    Parameters
    ----------
    title : str
        Heading; empty for none.
    tables : Table
        Those without rows are left out.
    sentences : sequence of str
        Shown first, emphasized; several as a list.
    facts : sequence of (name, value)
        Shown before the tables.
    titles : bool
        Whether each table has its own heading.
    links : mapping, optional
        Text of cells → anchor in the page that they link to.
    folded : bool
        As in `Section`.
    """
    data = {
        "tables": tables,
        "sentences": sentences,
        "facts": facts,
        "titles": titles,
        "links": links or {},
    }
    return Section(title, "tables.html", data, folded)
