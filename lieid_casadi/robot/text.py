"""Reading a description file, with errors that a person can act on."""

from __future__ import annotations

from pathlib import Path

from lieid_casadi.errors import RobotError


def read_text(path: str | Path) -> str:
    """Return the text of a file; `RobotError` if it is missing, a folder or not UTF-8."""
    try:
        return Path(path).read_text(encoding="utf-8")
    except FileNotFoundError:
        raise RobotError(f"{path}: no such file") from None
    except UnicodeDecodeError:
        raise RobotError(f"{path}: not a text file (expected UTF-8)") from None
    except OSError as error:
        raise RobotError(f"{path}: cannot be read: {error.strerror}") from None
