"""Sections as one self-contained HTML file with embedded figures."""

from __future__ import annotations

import re
import unicodedata
from base64 import b64encode
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from io import BytesIO
from typing import TYPE_CHECKING, Any

from lieid_casadi.plot_style import Figure
from lieid_casadi.tables import Table

if TYPE_CHECKING:
    from jinja2 import Environment


@dataclass(frozen=True)
class Section:
    """One part of a report: the ``data`` that a file in ``report/templates`` shows.

    Text is escaped there, since names of joints and recordings come from files of others. A
    ``folded`` section is a heading that opens with a click.
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
    notes: Sequence[str] = (),
    titles: bool = False,
    links: Mapping[str, str] | None = None,
    text: Collection[str] = (),
    weak: Sequence[bool] = (),
    folded: bool = False,
) -> Section:
    """Return a section of emphasized sentences, facts, tables and notes, in this order.

    Tables without rows are left out; ``links`` are texts of cells and their anchors in the page,
    ``text`` headings of columns that are aligned left (as long texts are anyway).
    """
    data = {
        "title": title,
        "csv": csv_uri,
        "file": csv_name,
        "tables": tables,
        "sentences": sentences,
        "facts": facts,
        "notes": notes,
        "titles": titles,
        "links": links or {},
        "text": text,
        "weak": weak,
    }
    return Section(title, "tables.html", data, folded)


def picture_section(title: str, figure: Figure, note: str = "") -> Section:
    """Return a section of one figure with an explanation before it."""
    return Section(title, "picture.html", {"uri": data_uri(figure), "alt": title, "note": note})


def data_uri(figure: Figure, *, dpi: float = 110.0, colors: int | None = None) -> str:
    """Return a figure as a PNG in a ``data:`` URI, of as many colors (a quarter of the bytes)."""
    stream = BytesIO()
    figure.savefig(stream, format="png", dpi=dpi, metadata={"Software": None})
    if colors is not None:
        from PIL import Image  # Matplotlib requires it

        picture = Image.open(stream).convert("RGB").quantize(colors)
        stream = BytesIO()
        picture.save(stream, "png", optimize=True)
    return "data:image/png;base64," + b64encode(stream.getvalue()).decode("ascii")


def csv_uri(table: Table) -> str:
    """Return a table as CSV in a ``data:`` URI."""
    content = table.csv.encode(errors="replace")
    return f"data:text/csv;charset=utf-8;base64,{b64encode(content).decode('ascii')}"


def csv_name(table: Table, section: str) -> str:
    """Return a file name for a table: words of its title, or of its section's."""
    words = re.findall(r"[a-z0-9]+", (table.title.partition(",")[0] or section).lower())
    return f"{'_'.join(words[:5]) or 'table'}.csv"


def render(title: str, sections: Sequence[Section]) -> str:
    """Return a page with these sections in their order."""
    from lieid_casadi import __version__

    environment = _environment()
    parts = [
        {
            "title": section.title,
            "anchor": f"section-{number}",
            "folded": section.folded,
            "body": environment.get_template(section.template).render(section.data),
        }
        for number, section in enumerate(sections, start=1)
    ]
    page = environment.get_template("page.html")
    return page.render(title=title, parts=parts, version=__version__)


def _visible(value: Any) -> Any:
    """Write out characters that change the direction of writing or cannot be seen."""
    if type(value) is not str:
        return value
    return "".join(
        f"\\u{ord(c):04x}" if unicodedata.category(c)[0] == "C" and c not in "\n\t" else c
        for c in value
    )


@cache
def _environment() -> Environment:
    from jinja2 import Environment, PackageLoader, StrictUndefined

    return Environment(
        loader=PackageLoader("lieid_casadi.report", "templates"),
        autoescape=True,
        undefined=StrictUndefined,
        finalize=_visible,
        trim_blocks=True,
        lstrip_blocks=True,
    )
