"""Tables of results, as the command line, reports and notebooks show them."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from html import escape

MISSING = "–"  # of a number that does not exist


@dataclass(frozen=True)
class Table:
    """A table of a result."""

    title: str
    headings: tuple[str, ...]  # one per column
    rows: tuple[tuple[object, ...], ...]  # cells: text, numbers, or None
    note: str = ""  # explanation of the columns, for reports

    @property
    def cells(self) -> list[list[str]]:
        """The rows as text."""
        return [[cell_text(cell) for cell in row] for row in self.rows]

    @property
    def csv(self) -> str:
        """Headings and cells as CSV, empty where a number does not exist."""
        text = io.StringIO()
        write = csv.writer(text, lineterminator="\n").writerow
        write(self.headings)
        for row in self.cells:
            write("" if cell == MISSING else cell for cell in row)
        return text.getvalue()


def make_table(
    title: str, headings: Sequence[str], rows: Iterable[Sequence[object]], *, note: str = ""
) -> Table:
    """Return a table."""
    return Table(title, tuple(headings), tuple(tuple(row) for row in rows), note)


def cell_text(cell: object) -> str:
    """Return a cell as text; numbers with four significant digits.

    Examples
    --------
    >>> cell_text(12.34567), cell_text(None), cell_text(float("nan")), cell_text("q1")
    ('12.35', '–', '–', 'q1')
    """
    if cell is None or cell != cell:
        return MISSING
    return f"{cell:.4g}" if isinstance(cell, float) else str(cell)


def figures(value: float | None, *, digits: int = 3, sign: str = "") -> str:
    """Return a number with some significant digits, a dash if it is unknown.

    Examples
    --------
    >>> figures(0.19843), figures(12.3456, digits=2), figures(0.5, sign="+"), figures(None)
    ('0.198', '12', '+0.500', '–')
    """
    if value is None or value != value:
        return MISSING
    if value == 0.0 or 1e-3 <= abs(value) < 1e4:
        exponent = int(f"{value:.{digits - 1}e}".partition("e")[2])
        return f"{value:{sign}.{max(0, digits - 1 - exponent)}f}"
    return f"{value:{sign}.{digits - 1}e}"


def value_text(value: float, std: float | None) -> str:
    """Return a value to the second digit of its standard deviation."""
    if not std or not math.isfinite(std):
        return f"{value:.4g}"
    decimals = 1 - math.floor(math.log10(std))
    return f"{value:z.{decimals}f}" if 0 <= decimals <= 8 else f"{value:.4g}"


def std_text(std: float | None) -> str | None:
    """Return a standard deviation with two digits."""
    return None if std is None else f"{std:#.2g}".rstrip(".")


def with_std(value: float, std: float | None) -> str:
    """Return a value ± its standard deviation; the value alone without one.

    Examples
    --------
    >>> with_std(12.3456, 0.021), with_std(12.3456, None), with_std(12.3456, math.nan)
    ('12.346 ± 0.021', '12.35', '12.35')
    """
    known = std is not None and not math.isnan(std)
    return value_text(value, std) + (f" ± {std_text(std)}" if known else "")


def html(*parts: str | Table) -> str:
    """Return paragraphs and tables as HTML, as notebooks show them; all text is escaped.

    Examples
    --------
    >>> html("a < b")
    '<p>a &lt; b</p>'
    """
    return "".join(_table(x) if isinstance(x, Table) else f"<p>{escape(x)}</p>" for x in parts if x)


def _table(table: Table) -> str:
    head = "".join(f"<th>{escape(text)}</th>" for text in table.headings)
    body = "".join(
        "<tr>" + "".join(f"<td>{escape(text)}</td>" for text in row) + "</tr>"
        for row in table.cells
    )
    title = f"<caption>{escape(table.title)}</caption>" if table.title else ""
    return f"<table>{title}<thead><tr>{head}</tr></thead><tbody>{body}</tbody></table>"
