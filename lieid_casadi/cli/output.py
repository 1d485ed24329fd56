"""Output of commands: tables on stdout, progress on stderr, files as a whole."""

from __future__ import annotations

import io
import json
import sys
import unicodedata
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Literal

import lieid_casadi as lieid
from lieid_casadi.cli.options import Args
from lieid_casadi.errors import LieidWarning
from lieid_casadi.tables import Table

if TYPE_CHECKING:
    from rich.console import Console

    from lieid_casadi.arrays import Array

SCHEMA = 1  # of results as JSON
WIDTH = 120  # of tables that do not go to a terminal
LONGEST_WORD = 24  # characters of a table's cell that are not broken: labels, not paths


def console() -> Console:
    """Return the console of stdout."""
    from rich.console import Console

    class Stdout(Console):
        def on_broken_pipe(self) -> None:
            raise BrokenPipeError  # rich would exit with status 1

    width = None if sys.stdout.isatty() else WIDTH
    return Stdout(width=width, highlight=False, emoji=False)


def visible(text: str) -> str:
    r"""Return text in which characters that control a terminal are written out.

    Names come from files of others: control characters, those that change the direction of
    writing, and bytes that are not UTF-8 become escapes such as ``\x1b``.
    """
    return "".join(
        c.encode("unicode_escape").decode() if unicodedata.category(c)[0] == "C" else c
        for c in text
    )


def show(*items: str | Table | LieidWarning) -> None:
    """Print paragraphs, tables that have rows, and warnings on stdout."""
    for item in items:
        if isinstance(item, LieidWarning):
            item = f"  ! {type(item).__name__.removesuffix('Warning')}: {item}"
        if isinstance(item, str):
            lines = "\n".join(visible(line) for line in item.split("\n"))
            console().print(lines, markup=False, soft_wrap=True)
        elif item.rows:
            _show_table(item)


def _show_table(table: Table) -> None:
    """Print a table whose first column is aligned left, the others right."""
    from rich import box
    from rich.table import Table as RichTable
    from rich.text import Text

    shown = RichTable(
        title=Text(visible(table.title)),
        title_justify="left",
        box=box.SIMPLE_HEAD,
        title_style="bold",
    )
    widths = _word_widths(table)
    fits = sum(widths) + 2 * len(widths) <= console().width
    for k, (name, width) in enumerate(zip(table.headings, widths, strict=True)):
        justify: Literal["left", "right"] = "left" if k == 0 else "right"
        least = width if fits else None
        shown.add_column(Text(visible(name)), justify=justify, overflow="fold", min_width=least)
    for row in table.cells:
        shown.add_row(*(Text(visible(cell)) for cell in row))
    console().print(shown)


def _word_widths(table: Table) -> list[int]:
    """Return the length of the longest word of each column, at most `LONGEST_WORD`."""
    columns = zip(table.headings, *table.cells, strict=True)
    longest = (max(map(len, visible(" ".join(cells)).split()), default=0) for cells in columns)
    return [min(width, LONGEST_WORD) for width in longest]


def json_bytes(content: dict[str, Any]) -> bytes:
    """Return a result as JSON; bytes of names that are not UTF-8 become escapes."""
    text = json.dumps(content, indent=1, allow_nan=False, ensure_ascii=False)
    return text.encode(errors="backslashreplace")


def csv_bytes(t: Array, **signals: Array) -> bytes:
    """Return times (N,) and signals (N, n) as CSV with the columns t, NAME1 … NAMEn."""
    import numpy as np

    columns = [t[:, None], *signals.values()]
    names = ["t", *(f"{name}{j + 1}" for name, x in signals.items() for j in range(x.shape[1]))]
    text = io.StringIO()
    formats = ["%.15g", *["%.9g"] * (len(names) - 1)]
    np.savetxt(
        text, np.hstack(columns), fmt=formats, delimiter=",", header=",".join(names), comments=""
    )
    return text.getvalue().encode()


@dataclass(frozen=True)
class Outcome:
    """What a command found: its files are written, all or none, and then it is printed."""

    shown: Sequence[str | Table | LieidWarning] = ()
    json: Mapping[str, Any] | None = None
    html: Callable[[], str] | None = None
    fit: lieid.Fit | None = None  # of -o
    files: Mapping[str, Callable[[], bytes]] = field(default_factory=dict)  # of other options
    folder: Callable[[], object] | None = None  # writes the folder of -o, before the files
    status: int = 0

    def finish(self, args: Args) -> int:
        """Write all files, print, and return the exit status."""
        from lieid_casadi.atomic_file import atomic_binary

        contents = list(self._contents(args))
        if self.folder is not None:
            self.folder()
        with ExitStack() as stack:
            for path, content in contents:
                file = stack.enter_context(atomic_binary(path))
                file.write(content)
                file.flush()
        show(*self.shown)
        return self.status

    def _contents(self, args: Args) -> Iterator[tuple[str, bytes]]:
        """Yield path and content of the files that the options name."""
        from lieid_casadi.identification.fit import content_of

        fit, json, html = self.fit, self.json, self.html
        contents = dict(self.files)
        if fit is not None:
            contents["output"] = lambda: content_of(fit)
        if json is not None:
            contents["json"] = lambda: json_bytes({"schema": SCHEMA} | dict(json))
        if html is not None:
            contents["html"] = lambda: html().encode(errors="replace")  # names that are not UTF-8
        for name, content in contents.items():
            path: str | None = getattr(args, name, None)
            if path is not None:
                yield path, content()


@contextmanager
def progress(title: str) -> Iterator[Callable[[str, float], None]]:
    """Show a bar on stderr while work goes on, if stderr is a terminal."""
    if not sys.stderr.isatty():
        yield lambda stage, fraction: None
        return
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

    columns = (TextColumn("{task.description}", markup=False), BarColumn(), TimeElapsedColumn())
    with Progress(*columns, console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task(title, total=1.0)
        yield lambda stage, fraction: bar.update(
            task, completed=fraction, description=visible(f"{title}: {stage}")
        )
