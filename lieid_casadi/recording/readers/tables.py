"""Recordings from and to named columns (data frames, Parquet)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from lieid_casadi.errors import RecordingError
from lieid_casadi.recording.arrays import Array
from lieid_casadi.recording.measurement import FIELDS, Measurement
from lieid_casadi.recording.readers.columns import LABEL, layout_warnings, read_layout, shorten


def measurement_of_columns(
    columns: Mapping[str, Any], title: str, n: int | None = None
) -> Measurement:
    """Return a measurement from named columns; values are not checked yet.

    Parameters
    ----------
    columns
        Column name -> (N,) values; see `lieid_casadi.recording.readers.columns` for the names.
    title
        Name of the source, for messages.
    n
        Number of joints that is expected; None takes it from the columns.

    Raises
    ------
    RecordingError
        A missing column, one that does not hold numbers, or columns of unequal length.
    """
    names = list(columns)
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
        warnings=layout_warnings(layout, title),
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
            found = shorten(str(value))
            raise RecordingError(
                f"{where}, row {row + 1}: found {found}, expected a number"
            ) from None
    return converted
