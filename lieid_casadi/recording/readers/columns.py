"""Names of the columns of a recording, shared by CSV, Parquet, NPZ and data frames."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

from lieid_casadi.errors import LieidWarning, RecordingError, UnknownColumnWarning
from lieid_casadi.recording.measurement import FIELDS

#: Column of the payload's label.
LABEL = "load"
EXPECTED = "t,q1…qn and optionally dq*, tau*, ddq*, temp*, i*, qcmd*, load"

_JOINT_COLUMN = re.compile(r"(q|dq|ddq|tau|temp|i|qcmd)([0-9]{1,6})")


@dataclass(frozen=True)
class ColumnLayout:
    """Indices into a header: the column of each signal.

    Attributes
    ----------
    n
        Number of joints.
    time, label
        Columns of t and of the payload's label (None without one).
    fields
        Field of a measurement -> its n columns, in the order of the joints.
    unknown
        Names of the columns that are not used.
    """

    n: int
    time: int
    fields: dict[str, tuple[int, ...]]
    label: int | None
    unknown: tuple[str, ...]

    def used(self, header: Sequence[str]) -> list[str]:
        """Return the names, in the header, of the columns that hold signals."""
        indices = [self.time, *(i for columns in self.fields.values() for i in columns)]
        indices += [] if self.label is None else [self.label]
        return [header[index] for index in indices]


def shorten(text: str, length: int = 40) -> str:
    """Quoted text for a message, cut to a readable length."""
    return repr(text if len(text) <= length else text[: length - 1] + "…")


def listed(names: Sequence[str], most: int = 8) -> str:
    """Return names for a message, separated by commas; the first eight of a long list."""
    shown = [name if name.isprintable() else repr(name) for name in names[:most]]
    return ", ".join(shown) + (", …" if len(names) > most else "")


def read_layout(header: Sequence[str], where: str, n: int | None = None) -> ColumnLayout:
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
    for name, count in Counter(names).items():
        if name and count > 1:
            raise RecordingError(f"{where}: column {shorten(name)} occurs twice, expected it once")
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
    return ColumnLayout(joints, names.index("t"), fields, label, tuple(unknown))


def _count_joints(numbered: dict[str, dict[int, int]], where: str, n: int | None) -> int:
    if "q" not in numbered:
        raise RecordingError(f"{where}: no column q1, expected {EXPECTED}")
    count = max(max(indices) for indices in numbered.values())
    if n is not None and max(numbered["q"]) == len(numbered["q"]) == count != n:
        raise RecordingError(f"{where}: found {count} joints (q1…q{count}), expected {n}")
    for prefix, indices in numbered.items():
        for joint in range(1, count + 1):
            if joint not in indices:
                found = listed([f"{prefix}{j}" for j in sorted(indices)])
                raise RecordingError(
                    f"{where}: column {prefix}{joint} is missing (found {found}), "
                    f"expected {prefix}1…{prefix}{count}"
                )
    if n is not None and count != n:
        raise RecordingError(f"{where}: found columns of {count} joints, expected {n}")
    return count


def layout_warnings(layout: ColumnLayout, title: str) -> tuple[LieidWarning, ...]:
    """Return a warning that names the columns that are not used, if any."""
    if not layout.unknown:
        return ()
    return (
        UnknownColumnWarning(
            f"{title}: columns with unknown names ignored: {listed(layout.unknown)}"
        ),
    )
