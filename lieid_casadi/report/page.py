"""Sections as one self-contained HTML file."""

from __future__ import annotations

import unicodedata
from collections.abc import Sequence
from functools import cache
from typing import TYPE_CHECKING, Any

from lieid_casadi.report.section import Section

if TYPE_CHECKING:
    from jinja2 import Environment


def render(title: str, sections: Sequence[Section]) -> str:
    """Return a page with these sections in their order.

    Style and figures are embedded; a content policy in the page forbids loading anything.
    """
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
        loader=PackageLoader("lieid_casadi.report", "sections"),
        autoescape=True,
        undefined=StrictUndefined,
        finalize=_visible,
        trim_blocks=True,
        lstrip_blocks=True,
    )
