"""Tables as HTML, as notebooks show result objects."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from html import escape


def html_table(headings: Sequence[str], rows: Iterable[Sequence[str]], *, caption: str = "") -> str:
    """Return a table as HTML; all text is escaped.

    Parameters
    ----------
    headings : sequence of str
        One per column.
    rows : iterable of sequence of str
        Cells, one per column.
    caption : str
        Shown above the table; no caption if empty.

    Examples
    --------
    >>> html_table(["name"], [["a < b"]])
    '<table><thead><tr><th>name</th></tr></thead><tbody><tr><td>a &lt; b</td></tr></tbody></table>'
    """
    head = "".join(f"<th>{escape(text)}</th>" for text in headings)
    body = "".join(
        "<tr>" + "".join(f"<td>{escape(text)}</td>" for text in row) + "</tr>" for row in rows
    )
    title = f"<caption>{escape(caption)}</caption>" if caption else ""
    return f"<table>{title}<thead><tr>{head}</tr></thead><tbody>{body}</tbody></table>"


def number_cell(value: float | None, digits: int) -> str:
    """Return a number with so many significant digits, an en dash for None."""
    return "–" if value is None else f"{value:.{digits}g}"
