"""C text from templates: safe comments, and numbers that are read back bit by bit."""

from __future__ import annotations

import re
import textwrap
import unicodedata
from collections.abc import Iterable
from functools import cache
from html import escape
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from lieid_casadi.codegen_files import codegen_folder
from lieid_casadi.exporters.c.numbers import Precision

if TYPE_CHECKING:
    from jinja2 import Environment

WIDTH = 96


def comment(text: str) -> str:
    """Return text that is safe in a C comment, in one line.

    Names come from the user's files: comment marks, line ends (also by a backslash) and characters
    that reorder the text are removed.
    """
    shown = "".join(c if unicodedata.category(c)[0] != "C" else " " for c in text)
    shown = " ".join(shown.replace("\\", "/").split())
    return shown.replace("*/", "* /").replace("/*", "/ *").replace("??", "? ?")


def markdown(text: str) -> str:
    r"""Return text in one line without markup of Markdown or HTML.

    Examples
    --------
    >>> markdown("<b>|`a_1`")
    '&lt;b&gt;\\|\\`a_1\\`'
    """
    shown = escape(comment(text), quote=False)
    return re.sub(r"([\\`*\[\]|~$])", r"\\\1", shown)


def numbers(values: NDArray[np.float64], precision: Precision) -> str:
    """Return the initializers of an array, wrapped."""
    words = ", ".join(precision.number(float(value)).strip("()") for value in np.ravel(values))
    return textwrap.fill(words, WIDTH, initial_indent="    ", subsequent_indent="    ")


def numbered(names: Iterable[str]) -> list[str]:
    """Return lines ``0 NAME, 1 NAME, …`` for a comment."""
    words = [f"{k} {comment(name)}".replace(" ", "\0") for k, name in enumerate(names)]
    lines = textwrap.wrap(", ".join(words), WIDTH - 6, break_on_hyphens=False)
    return [line.replace("\0", " ") for line in lines]


def wrapped(texts: Iterable[str]) -> list[str]:
    """Return texts as lines of a list for a comment."""
    lines = []
    for text in texts:
        lines += textwrap.wrap(text, WIDTH - 4, initial_indent="- ", subsequent_indent="  ")
    return lines


def render(template: str, content: dict[str, Any]) -> str:
    """Return the text of a template of ``codegen/export``."""
    return _environment().get_template(template).render(content)


@cache
def _environment() -> Environment:
    from jinja2 import Environment, FileSystemLoader, StrictUndefined

    environment = Environment(
        loader=FileSystemLoader(codegen_folder() / "export"),
        autoescape=False,  # C, not HTML; names pass through `comment`
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
    )
    environment.filters["numbers"] = numbers
    environment.filters["markdown"] = markdown
    return environment
