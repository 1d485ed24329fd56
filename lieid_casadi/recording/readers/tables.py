"""Recordings from and to named columns (data frames, Parquet)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from lieid_casadi.errors import LieidWarning, RecordingError, UnknownColumnWarning
from lieid_casadi.recording.arrays import Array
from lieid_casadi.recording.readers.columns import FIELDS, LABEL, Layout, read_layout, shorten
from lieid_casadi.recording.recording import Recording


def recording_from_columns(
    columns: Mapping[str, Any], title: str, n: int | None = None
) -> Recording:
    """Recording from arrays of length N by column name; not yet checked for NaN.

    Raises
    ------
    RecordingError
        A missing column, or one that does not hold numbers.
    """
    names = list(columns)
    layout = read_layout(names, title, n)

    def number(index: int) -> Array:
        return _numbers(columns[names[index]], f"{title}: column {names[index]}")

    label = None if layout.label is None else columns[names[layout.label]]
    signals: dict[str, Any] = {
        field: _side_by_side([number(index) for index in indices])
        for field, indices in layout.fields.items()
    }
    return Recording(
        t=number(layout.time),
        payload_label=None if label is None else tuple(str(x) for x in label),
        name=title,
        warnings=layout_warnings(layout, title),
        **signals,
    )


def columns_of(recording: Recording) -> dict[str, Any]:
    """Columns by their names in files: t, q1…qn, dq1…dqn, tau1…taun, then the optional ones."""
    columns: dict[str, Any] = {"t": recording.t}
    for prefix, field in FIELDS.items():
        values = getattr(recording, field)
        if values is not None:
            columns |= {f"{prefix}{j + 1}": values[:, j] for j in range(recording.n)}
    if recording.payload_label is not None:
        columns[LABEL] = recording.payload_label
    return columns


def layout_warnings(layout: Layout, title: str) -> tuple[LieidWarning, ...]:
    """A warning that names the columns that were left aside, if any."""
    if not layout.unknown:
        return ()
    names = ", ".join(layout.unknown[:8]) + (", …" if len(layout.unknown) > 8 else "")
    return (UnknownColumnWarning(f"{title}: columns left aside, names unknown: {names}"),)


def _side_by_side(columns: Sequence[Array]) -> Array:
    """Columns as one array that `read_only` need not copy."""
    stacked = np.column_stack(columns)
    stacked.flags.writeable = False
    return stacked


def _numbers(values: Any, where: str) -> Array:
    array = np.asarray(values)
    if array.ndim != 1:
        raise RecordingError(f"{where}: found shape {array.shape}, expected (N,)")
    if array.dtype.kind in "iufb":
        return array.astype(np.float64, copy=False)
    converted = np.empty(array.size)
    for row, value in enumerate(array):
        try:
            converted[row] = float(value)
        except (TypeError, ValueError):
            found = shorten(str(value))
            raise RecordingError(
                f"{where}, row {row + 1}: found {found}, expected a number"
            ) from None
    return converted
