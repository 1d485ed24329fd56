"""Names of the columns of a recording, shared by CSV, Parquet, NPZ and data frames.

Recorders write ``position_1``, ``actual_q_0`` or ``elbow_joint/velocity``. Such names are accepted
where each signal of each joint has exactly one column; ``--columns`` states all others.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from lieid_casadi.arrays import Array
from lieid_casadi.errors import (
    ColumnNamesWarning,
    LieidWarning,
    RecordingError,
    UnknownColumnWarning,
)
from lieid_casadi.messages import names_text, shortened
from lieid_casadi.recording.measurement import FIELDS, OPTIONAL_SIGNALS, Measurement

#: Columns of a recording as NAME=COLUMN, or name and column; see `parse_columns`.
ColumnNames = str | Mapping[str, str]
#: Column of the payload's label.
LABEL = "load"
#: Words in the names of columns, for each prefix of the file format.
WORDS = {
    "q": {"q", "position", "positions", "pos", "angle"},
    "dq": {"dq", "qd", "velocity", "velocities", "vel"},
    "ddq": {"ddq", "qdd", "acceleration", "accelerations", "acc"},
    "tau": {"tau", "effort", "efforts", "torque", "torques", "moment", "moments"},
    "i": {"i", "current", "currents"},
    "temp": {"temp", "temperature", "temperatures"},
}
TIMES = ("t", "time", "timestamp", "stamp", "time_s", "seconds", "__time", "%time")
#: A unit of the file format behind a name, as in ``q1 [rad]``.
SI_UNIT = re.compile(r"\s*[\[(](s|rad|rad/s|rad/s\^?2|rad/s²|N\s?[·.*]?m|A|°C)[\])]$")
#: Words of commanded signals, of which only positions are used.
COMMANDED = {"target", "desired", "command", "commanded", "cmd", "goal", "reference", "ref", "d"}
#: Words of other quantities of a joint, and of other units.
OTHERS = {"ext", "external", "error", "std", "filtered", "hat", "tcp", "limit", "min", "max"}
OTHERS |= {"deg", "degree", "degrees", "rpm", "rev", "mm", "ma", "nmm"}

_NAME = re.compile(r"t|load|(?:q|dq|ddq|tau|temp|i|qcmd)(?:[1-9][0-9]{0,5})?")


def parse_columns(columns: ColumnNames | None) -> tuple[tuple[str, str], ...]:
    """Return pairs of name and column of ``NAME=COLUMN,…``.

    NAME is one of the file format, such as ``tau1``, or a prefix such as ``tau`` for a whole
    signal: COLUMN is then an array of an NPZ, or has ``*`` in place of the joint's number. COLUMN
    may be a name of the file format, too, of any file: ``tau2=tau3,tau3=tau2``, or ``i=tau``.
    """
    if columns is None:
        return ()
    if isinstance(columns, str):
        given = [text.partition("=") for text in columns.split(",") if text.strip()]
        pairs = [(name.strip(), column.strip()) for name, _, column in given]
    else:
        pairs = [(str(name), str(column)) for name, column in columns.items()]
    for name, column in pairs:
        if not _NAME.fullmatch(name) or not column:
            raise RecordingError(
                f"columns: found {shortened(f'{name}={column}')}, expected NAME=COLUMN with NAME "
                f"one of t, load, {', '.join(FIELDS)} and a joint's number, such as tau1=effort_1"
            )
        if [n for n, _ in pairs].count(name) > 1:
            raise RecordingError(f"columns: found {name} twice, expected it once")
    return tuple(pairs)


def is_name(name: str) -> bool:
    """Return whether a name is that of a signal of all joints, or of one, in the file format."""
    return _NAME.fullmatch(name) is not None


def signal_names(
    header: Sequence[str],
    where: str,
    columns: Sequence[tuple[str, str]] = (),
    joint_names: Sequence[str] | None = None,
) -> tuple[list[str], tuple[LieidWarning, ...]]:
    """Return the header with the names of the file format, and a warning of those assumed."""
    names = [name.strip() for name in header]
    if columns:
        return _stated(names, where, columns), ()
    names = [SI_UNIT.sub("", name) for name in names]
    if "t" in names and ("q1" in names or "q" in names):
        return names, ()
    found = _known(names, joint_names or ())
    if found is None:
        return names, ()
    made = [found.get(name, name) for name in names]
    pairs = [f"{new} = {old}" for old, new in found.items() if old != new]
    warning = ColumnNamesWarning(f"{where}: columns read as signals: {names_text(pairs, 12)}")
    return made, (warning,)


def _stated(names: Sequence[str], where: str, columns: Sequence[tuple[str, str]]) -> list[str]:
    new: dict[str, str] = {}
    for name, column in columns:
        for number, found in enumerate(_matching(names, column), start=1):
            new[found] = f"{name}{number}" if "*" in column else name
        if not any(place in new for place in _matching(names, column)):
            raise RecordingError(
                f"{where}: no column {shortened(column)} (found {names_text(names)}), expected "
                f"that of {name}"
            )
    taken = set(new.values())
    return [new.get(name, f"{name} of the file" if name in taken else name) for name in names]


def _matching(names: Iterable[str], column: str) -> list[str]:
    """Return the columns of a name, those with a number in place of ``*`` by that number."""
    before, star, after = column.partition("*")
    if not star:
        return [name for name in names if name == column]
    pattern = re.compile(rf"{re.escape(before)}([0-9]{{1,6}}){re.escape(after)}")
    found = [(int(m[1]), name) for name in names if (m := pattern.fullmatch(name))]
    return [name for _, name in sorted(found)]


def _known(names: Sequence[str], joint_names: Sequence[str]) -> dict[str, str] | None:
    """Return column -> name of the file format where this is unambiguous, else None."""
    times = [name for name in names if name.lower() in TIMES]
    signals = {name: found for name in names if (found := _signal(name, joint_names))}
    joints = {joint for prefix, joint, _ in signals.values() if prefix == "q"}
    numbered = {by_number for _, _, by_number in signals.values()}
    first = min(joints, default=1)
    complete = joints == set(range(first, first + len(joints))) and first in (0, 1)
    if len(times) != 1 or not joints or not complete or len(numbered) != 1:
        return None
    made = {name: f"{prefix}{joint + 1 - first}" for name, (prefix, joint, _) in signals.items()}
    inside = all(joint in joints for _, joint, _ in signals.values())
    if not inside or len(set(made.values())) < len(made):
        return None
    load = {LABEL: LABEL} if LABEL in names else {}
    return {times[0]: "t"} | made | load


def _signal(name: str, joint_names: Sequence[str]) -> tuple[str, int, bool] | None:
    """Return prefix, joint, and whether the joint is a number, of a column's name."""
    text = re.sub(r"(?<=[a-z])(?=[A-Z])", "_", name).lower()
    joint = None
    for index, known in enumerate(joint_names):
        pattern = rf"(?<![a-z0-9]){re.escape(known.lower())}(?![a-z0-9])"
        if re.search(pattern, text):
            joint, text = index + 1, re.sub(pattern, "", text)
            break
    words = set(re.findall(r"[a-z]+", text))
    numbers = re.findall(r"[0-9]{1,6}", text)
    prefix = prefix_of(words)
    if prefix is None:
        return None
    if joint is not None:
        return (prefix, joint, False) if not numbers else None
    return (prefix, int(numbers[0]), True) if len(numbers) == 1 else None


def prefix_of(words: set[str]) -> str | None:
    """Return the prefix of the signal that the words of a column's name mean."""
    prefixes = [prefix for prefix, known in WORDS.items() if words & known]
    if len(prefixes) != 1 or words & OTHERS:
        return None
    if words & COMMANDED:
        return "qcmd" if prefixes == ["q"] else None
    return prefixes[0]


REMEDY = "other names are stated by --columns NAME=COLUMN,… (columns= in Python)"
EXPECTED = "t,q1…qn and optionally dq*, tau*, ddq*, temp*, i*, qcmd*, load"

_JOINT_COLUMN = re.compile(r"(q|dq|ddq|tau|temp|i|qcmd)([0-9]{1,6})")


@dataclass(frozen=True)
class ColumnLayout:
    """Indices into a header: the column of each signal."""

    names: tuple[str, ...]  # of all columns in the file format
    time: int
    fields: dict[str, tuple[int, ...]]  # field of a measurement -> its columns, one per joint
    label: int | None  # of the payload
    warnings: tuple[LieidWarning, ...]  # of names that were assumed, and of columns not used

    @property
    def numeric(self) -> list[int]:
        """The columns that hold numbers, time first."""
        return [self.time, *(i for columns in self.fields.values() for i in columns)]

    def used(self, header: Sequence[str] | None = None) -> list[str]:
        """Return the names of the columns that hold signals, or those in a header."""
        indices = self.numeric + ([] if self.label is None else [self.label])
        return [(self.names if header is None else header)[index] for index in indices]


def read_layout(
    header: Sequence[str],
    where: str,
    n: int | None = None,
    columns: Sequence[tuple[str, str]] = (),
    joint_names: Sequence[str] | None = None,
    *,
    title: str = "",
) -> ColumnLayout:
    """Find the columns of a recording in a header; ``title`` is that of warnings."""
    names, warnings = signal_names(header, where, columns, joint_names)
    for name, count in Counter(names).items():
        if name and count > 1:
            raise RecordingError(
                f"{where}: column {shortened(name)} occurs twice, expected it once"
            )
    if "t" not in names:
        found = shortened(",".join(names))
        raise RecordingError(
            f"{where}: found {found}, expected a header with column t ({EXPECTED}); {REMEDY}"
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
        elif name not in ("t", LABEL, ""):  # indices of tables have no name
            unknown.append(name)
    joints = _count_joints(numbered, where, n)
    fields = {
        FIELDS[prefix]: tuple(indices[j] for j in range(1, joints + 1))
        for prefix, indices in numbered.items()
    }
    label = names.index(LABEL) if LABEL in names else None
    if unknown:
        text = f"{title or where}: columns with unknown names ignored: {names_text(unknown)}"
        warnings += (UnknownColumnWarning(text),)
    return ColumnLayout(tuple(names), names.index("t"), fields, label, warnings)


def _count_joints(numbered: dict[str, dict[int, int]], where: str, n: int | None) -> int:
    if "q" not in numbered:
        raise RecordingError(f"{where}: no column q1, expected {EXPECTED}; {REMEDY}")
    count = max(max(indices) for indices in numbered.values())
    if n is not None and max(numbered["q"]) == len(numbered["q"]) == count != n:
        remark = "; delete the columns of joints that the robot does not have" if count > n else ""
        raise RecordingError(f"{where}: found {count} joints (q1…q{count}), expected {n}{remark}")
    for prefix, indices in numbered.items():
        for joint in range(1, count + 1):
            if joint not in indices:
                found = names_text([f"{prefix}{j}" for j in sorted(indices)])
                raise RecordingError(
                    f"{where}: column {prefix}{joint} is missing (found {found}), "
                    f"expected {prefix}1…{prefix}{count}"
                )
    if n is not None and count != n:
        raise RecordingError(f"{where}: found columns of {count} joints, expected {n}")
    return count


def measurement_of_columns(
    given: Mapping[str, Any],
    title: str,
    n: int | None = None,
    stated: Sequence[tuple[str, str]] = (),
) -> Measurement:
    """Return a measurement from named columns; values are not checked yet."""
    layout = read_layout(list(given), title, n, stated)
    names = layout.names
    columns = dict(zip(names, given.values(), strict=True))
    rows = len(columns[names[layout.time]])
    for name in layout.used():
        if len(columns[name]) != rows:
            found = f"found {len(columns[name])} values and {rows} times"
            raise RecordingError(f"{title}: column {name}: {found}, expected as many")

    def number(index: int) -> Array:
        return _numbers(columns[names[index]], f"{title}: column {names[index]}")

    label = None if layout.label is None else columns[names[layout.label]]
    signals: dict[str, Any] = {
        field: _side_by_side([number(index) for index in indices])
        for field, indices in layout.fields.items()
    }
    return Measurement(
        t=number(layout.time),
        payload_label=None if label is None else tuple(str(x) for x in label),
        name=title,
        warnings=layout.warnings,
        **signals,
    )


def reassigned(
    measurement: Measurement, stated: Sequence[tuple[str, str]], n: int | None = None
) -> Measurement:
    """Return a measurement with signals taken for others: pairs of names such as tau2, tau3."""
    columns, source = columns_of(measurement), dict[str, str]()
    for name, column in stated:
        joint = "" if column[-1].isdigit() or column in columns else "[0-9]+"
        own = [c for c in columns if re.fullmatch(column + joint, c)]
        if not own:
            raise RecordingError(
                f"{measurement.title}: no column {column} (found {names_text(list(columns))}), "
                f"expected that of {name}"
            )
        source |= {name + c[len(column) :]: c for c in own}
    kept = {c: x for c, x in columns.items() if c not in source.values()}
    given = kept | {name: columns[c] for name, c in source.items()}
    if n is not None and measurement.n > n:
        for name in (c for c in columns if (m := _JOINT_COLUMN.fullmatch(c)) and int(m[2]) <= n):
            if name not in source:  # that of another joint
                raise RecordingError(
                    f"{measurement.title}: columns of q1…q{n} are stated, that of {name} is not; "
                    "expected NAME=COLUMN of every signal"
                )
        given = {c: x for c, x in given.items() if c in source or not _JOINT_COLUMN.fullmatch(c)}
    made = measurement_of_columns(given, measurement.title, n)
    signals = {field: getattr(made, field) for field in ("t", "q", *OPTIONAL_SIGNALS)}
    return replace(measurement, payload_label=made.payload_label, **signals)


def columns_of(measurement: Measurement) -> dict[str, Any]:
    """Return columns by their names in files: t, q1…qn, dq1…dqn, tau1…taun, then the others."""
    columns: dict[str, Any] = {"t": measurement.t}
    for prefix, field in FIELDS.items():
        values = getattr(measurement, field)
        if values is not None:
            columns |= {f"{prefix}{j + 1}": values[:, j] for j in range(measurement.n)}
    if measurement.payload_label is not None:
        columns[LABEL] = measurement.payload_label
    return columns


def _side_by_side(columns: Sequence[Array]) -> Array:
    """Return columns as one array that `read_only` need not copy."""
    stacked = np.column_stack(columns)
    stacked.flags.writeable = False
    return stacked


def _numbers(values: Any, where: str) -> Array:
    array = np.asarray(values)
    if array.ndim != 1:
        raise RecordingError(f"{where}: found shape {array.shape}, expected (N,)")
    if array.dtype.kind not in "iufbOUST":
        raise RecordingError(f"{where}: found {array.dtype}, expected numbers")
    if array.dtype.kind in "iufb":
        return array.astype(np.float64, copy=False)
    converted = np.empty(array.size)
    for row, value in enumerate(array):
        try:
            converted[row] = np.nan if value is None else float(value)
        except (TypeError, ValueError, OverflowError):
            found = shortened(str(value))
            raise RecordingError(
                f"{where}, row {row + 1}: found {found}, expected a number"
            ) from None
    return converted
