"""How messages write joints, numbers, names and texts from files."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np


def joints_text(joints: Iterable[object]) -> str:
    """Return ``joint 2`` or ``joints 2, 3`` for a mask over the joints."""
    numbers = [str(index + 1) for index in np.nonzero(np.asarray(list(joints)))[0]]
    return f"joint{'s' if len(numbers) > 1 else ''} {', '.join(numbers)}"


def in_unit(number: str, unit: str) -> str:
    """Return a number with its unit; that of a ratio, 1, is not written."""
    return number if unit in ("", "1") else f"{number} {unit}"


def names_text(names: Sequence[str], most: int = 8) -> str:
    """Return names separated by commas; the first eight of a long list."""
    shown = [name if name.isprintable() else repr(name) for name in names[:most]]
    return ", ".join(shown) + (", …" if len(names) > most else "")


def shortened(text: str, length: int = 40) -> str:
    """Return a quoted text, cut to a readable length."""
    return repr(text if len(text) <= length else text[: length - 1] + "…")


def reason_of(error: BaseException) -> str:
    """Return the message of a library's exception as one short, printable line."""
    text = " ".join(str(error).split()) or type(error).__name__
    text = "".join(c if c.isprintable() else "?" for c in text)
    return text if len(text) <= 200 else f"{text[:199]}…"
