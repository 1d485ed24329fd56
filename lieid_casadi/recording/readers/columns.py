"""Names of the columns of a recording, shared by CSV, Parquet, NPZ and data frames."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass

from lieid_casadi.errors import RecordingError

#: Prefix in files -> field of Recording.
FIELDS = {
    "q": "q",
    "dq": "dq",
    "tau": "tau",
    "ddq": "ddq",
    "temp": "temperature",
    "i": "current",
}
#: Column of the payload's label.
LABEL = "load"
EXPECTED = "t,q1…qn and optionally dq*, tau*, ddq*, temp*, i*, load"

_JOINT_COLUMN = re.compile(r"(q|dq|ddq|tau|temp|i)(\d+)")


@dataclass(frozen=True)
class Layout:
    """Which column holds what: indices into the header."""

    n: int
    time: int
    fields: dict[str, tuple[int, ...]]
    label: int | None
    unknown: tuple[str, ...]


def shorten(text: str, length: int = 40) -> str:
    """Quoted text for a message, cut to a readable length."""
    return repr(text if len(text) <= length else text[: length - 1] + "…")


def read_layout(header: Sequence[str], where: str, n: int | None = None) -> Layout:
    """Find the columns of a recording in a header.

    Parameters
    ----------
    header
        Column names, in any order; joints are numbered from 1.
    where
        Start of the messages: file name and line.
    n
        Number of joints that is expected; None takes it from the columns.

    Raises
    ------
    RecordingError
        A column is missing or doubled, or the number of joints is not ``n``.
    """
    names = [name.strip() for name in header]
    for name in names:
        if name and names.count(name) > 1:
            raise RecordingError(f"{where}: column {name!r} occurs twice, expected it once")
    if "t" not in names:
        found = shorten(",".join(names))
        raise RecordingError(
            f"{where}: found {found}, expected a header with column t ({EXPECTED})"
        )
    numbered: dict[str, dict[int, int]] = {}
    unknown = []
    for index, name in enumerate(names):
        match = _JOINT_COLUMN.fullmatch(name)
        if match:
            joint = int(match[2])
            if joint == 0 or match[2][0] == "0":
                raise RecordingError(f"{where}: found column {name!r}, expected joints from 1")
            numbered.setdefault(match[1], {})[joint] = index
        elif name not in ("t", LABEL):
            unknown.append(name)
    joints = _count_joints(numbered, where, n)
    fields = {
        FIELDS[prefix]: tuple(indices[j] for j in range(1, joints + 1))
        for prefix, indices in numbered.items()
    }
    label = names.index(LABEL) if LABEL in names else None
    return Layout(joints, names.index("t"), fields, label, tuple(unknown))


def _count_joints(numbered: dict[str, dict[int, int]], where: str, n: int | None) -> int:
    if "q" not in numbered:
        raise RecordingError(f"{where}: no column q1, expected {EXPECTED}")
    count = max(max(indices) for indices in numbered.values())
    if n is not None and max(numbered["q"]) == len(numbered["q"]) == count != n:
        raise RecordingError(f"{where}: found {count} joints (q1…q{count}), expected {n}")
    for prefix, indices in numbered.items():
        for joint in range(1, count + 1):
            if joint not in indices:
                found = ", ".join(f"{prefix}{j}" for j in sorted(indices))
                raise RecordingError(
                    f"{where}: column {prefix}{joint} is missing (found {found}), "
                    f"expected {prefix}1…{prefix}{count}"
                )
    if n is not None and count != n:
        raise RecordingError(f"{where}: found columns of {count} joints, expected {n}")
    return count
