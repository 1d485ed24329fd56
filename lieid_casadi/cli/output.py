"""What a command shows and writes: tables on stdout, progress on stderr, files whole or not."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from lieid_casadi.errors import LieidWarning, UsageError

if TYPE_CHECKING:
    from rich.console import Console

WIDTH = 120  # of tables that do not go to a terminal


def console() -> Console:
    """Return the console of stdout."""
    from rich.console import Console

    return Console(width=None if sys.stdout.isatty() else WIDTH, highlight=False)


def table(title: str, columns: Sequence[str], rows: Sequence[Sequence[object]]) -> None:
    """Print a table; the first column is text, the others are numbers."""
    from rich import box
    from rich.markup import escape
    from rich.table import Table

    shown = Table(title=title, title_justify="left", box=box.SIMPLE_HEAD, title_style="bold")
    for k, name in enumerate(columns):
        shown.add_column(escape(name), justify="left" if k == 0 else "right", overflow="fold")
    for row in rows:
        shown.add_row(*(escape(_text(cell)) for cell in row))
    console().print(shown)


def _text(cell: object) -> str:
    if cell is None:
        return "–"
    if isinstance(cell, float):
        return "–" if cell != cell else f"{cell:.4g}"
    return str(cell)


def say(text: str) -> None:
    """Print one paragraph on stdout."""
    console().print(text, markup=False, soft_wrap=True)


def show_warnings(warnings: Sequence[LieidWarning]) -> None:
    """Print named warnings under a result."""
    for warning in warnings:
        say(f"  ! {type(warning).__name__.removesuffix('Warning')}: {warning}")


def write_json(path: str | None, content: dict[str, Any]) -> None:
    """Write a result as JSON, atomically; nothing if no file was asked for."""
    if path is not None:
        text = json.dumps(content, indent=1, allow_nan=False, ensure_ascii=False)
        write_file(path, text.encode())


def write_file(path: str | Path, content: bytes) -> None:
    """Write a file whole or not at all, making its folder."""
    from lieid_casadi.atomic_file import atomic_binary

    target = Path(path)
    check_writable(target)
    target.parent.mkdir(parents=True, exist_ok=True)
    with atomic_binary(target) as file:
        file.write(content)


def check_writable(*paths: str | Path | None) -> None:
    """Refuse output paths that cannot be written, before any work is done.

    Raises
    ------
    UsageError
    """
    import os

    for path in paths:
        if path is None:
            continue
        target = Path(path)
        if target.is_dir():
            raise UsageError(f"{path}: is a folder; expected a file to write")
        folder = target.parent
        while not folder.exists() and folder != folder.parent:
            folder = folder.parent
        if not folder.is_dir():
            raise UsageError(f"{path}: cannot be written: {folder} is not a folder")
        if not os.access(folder, os.W_OK | os.X_OK):
            raise UsageError(f"{path}: cannot be written: no permission in {folder}")


@contextmanager
def progress(title: str) -> Iterator[Callable[[str, float], None]]:
    """Show a bar on stderr while work goes on, if stderr is a terminal."""
    if not sys.stderr.isatty():
        yield lambda stage, fraction: None
        return
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

    columns = (TextColumn("{task.description}"), BarColumn(), TimeElapsedColumn())
    with Progress(*columns, console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task(title, total=1.0)
        yield lambda stage, fraction: bar.update(
            task, completed=fraction, description=f"{title}: {stage}"
        )
