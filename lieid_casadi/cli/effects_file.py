"""The option --effects-file: a Python file that registers effects of the user."""

from __future__ import annotations

from pathlib import Path

from lieid_casadi.errors import UsageError


def load(path: str | None) -> None:
    """Run the user's own Python file, which registers effects."""
    if path is None:
        return
    import runpy

    if not Path(path).is_file():
        raise UsageError(f"{path}: no such file; --effects-file expects your own Python file")
    try:
        runpy.run_path(path)
    except KeyboardInterrupt:
        raise
    except BaseException as error:  # SystemExit too, and what others derive from it
        raise UsageError(exception_in(path, error) or f"{path}: {error}") from error


def exception_in(path: str, error: BaseException) -> str | None:
    """Return text that names the line of a file where an exception was raised, if it was there."""
    import traceback

    lines = [
        frame.lineno
        for frame in traceback.extract_tb(error.__traceback__)
        if frame.filename == path
    ]
    if isinstance(error, SyntaxError) and error.filename == path:
        lines.append(error.lineno)
    if not lines:
        return None
    return f"{path}, line {lines[-1]}: {type(error).__name__}: {error}"
