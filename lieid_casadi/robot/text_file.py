"""Reading the text of a description file."""

from __future__ import annotations

from pathlib import Path

from lieid_casadi.errors import RobotError

LARGEST = 16_000_000  # bytes; descriptions with every mesh's name take well below one million


def read_text(path: str | Path) -> str:
    """Return the text of a file.

    Raises
    ------
    RobotError
        The file is missing, a folder, not UTF-8, or larger than `LARGEST`.
    """
    try:
        with open(path, "rb") as file:
            data = file.read(LARGEST + 1)
    except FileNotFoundError:
        raise RobotError(f"{path}: no such file") from None
    except OSError as error:
        raise RobotError(f"{path}: cannot be read: {error.strerror}") from None
    if len(data) > LARGEST:
        raise RobotError(f"{path}: larger than {LARGEST // 1_000_000} MB; expected a description")
    try:
        return data.decode("utf-8")
    except UnicodeDecodeError:
        raise RobotError(f"{path}: not a text file (expected UTF-8)") from None
