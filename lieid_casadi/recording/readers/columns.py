"""Names of the columns of a recording, shared by CSV, Parquet, NPZ and data frames."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from lieid_casadi.arrays import Array
from lieid_casadi.errors import LieidWarning, RecordingError, UnknownColumnWarning
from lieid_casadi.messages import names_text, shortened
from lieid_casadi.recording.measurement import FIELDS, Measurement
from lieid_casadi.recording.readers.column_names import LABEL, signal_names

REMEDY = "other names are stated by --columns NAME=COLUMN,… (columns= in Python)"
EXPECTED = "t,q1…qn and optionally dq*, tau*, ddq*, temp*, i*, qcmd*, load"

_JOINT_COLUMN = re.compile(r"(q|dq|ddq|tau|temp|i|qcmd)([0-9]{1,6})")


@dataclass(frozen=True)
class ColumnLayout:
    """Indices into a header: the column of each signal."""

    n: int  # joints
    time: int
    fields: dict[str, tuple[int, ...]]  # field of a measurement -> its n columns
    label: int | None  # of the payload
    unknown: tuple[str, ...]  # names of the columns that are not used

    def used(self, header: Sequence[str]) -> list[str]:
        """Return the names, in the header, of the columns that hold signals."""
        indices = [self.time, *(i for columns in self.fields.values() for i in columns)]
        indices += [] if self.label is None else [self.label]
        return [header[index] for index in indices]


def read_layout(header: Sequence[str], where: str, n: int | None = None) -> ColumnLayout:
    """Find the columns of a recording in a header."""
    names = [name.strip() for name in header]
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
        raise RecordingError(f"{where}: no column q1, expected {EXPECTED}; {REMEDY}")
    count = max(max(indices) for indices in numbered.values())
    if n is not None and max(numbered["q"]) == len(numbered["q"]) == count != n:
        raise RecordingError(f"{where}: found {count} joints (q1…q{count}), expected {n}")
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


def layout_warnings(layout: ColumnLayout, title: str) -> tuple[LieidWarning, ...]:
    """Return a warning that names the columns that are not used, if any."""
    if not layout.unknown:
        return ()
    return (
        UnknownColumnWarning(
            f"{title}: columns with unknown names ignored: {names_text(layout.unknown)}"
        ),
    )


def measurement_of_columns(
    given: Mapping[str, Any],
    title: str,
    n: int | None = None,
    stated: Sequence[tuple[str, str]] = (),
) -> Measurement:
    """Return a measurement from named columns; values are not checked yet."""
    names, warnings = signal_names(list(given), title, stated)
    columns = dict(zip(names, given.values(), strict=True))
    layout = read_layout(names, title, n)
    rows = len(columns[names[layout.time]])
    for name in layout.used(names):
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
        warnings=(*warnings, *layout_warnings(layout, title)),
        **signals,
    )


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
