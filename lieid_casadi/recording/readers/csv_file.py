"""Recordings as CSV, plain or gzipped."""

from __future__ import annotations

import csv
import gzip
import hashlib
import io
import zlib
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from lieid_casadi.atomic_file import atomic_binary
from lieid_casadi.errors import RecordingError
from lieid_casadi.recording.arrays import Array
from lieid_casadi.recording.checks.faults import first_fault
from lieid_casadi.recording.readers.columns import EXPECTED, Layout, read_layout, shorten
from lieid_casadi.recording.readers.tables import columns_of, layout_warnings
from lieid_casadi.recording.recording import Recording


def load_csv(
    file: Path,
    *,
    n: int | None = None,
    joint_names: Sequence[str] | None = None,
    topic: str | None = None,
) -> Recording:
    """Read a CSV with a header; joint names and topic play no part here.

    Raises
    ------
    RecordingError
        Names file, line and column, what was found and what was expected.
    """
    content = file.read_bytes()
    lines = _text(file, content).splitlines()
    rows = [k for k, line in enumerate(lines) if line.strip()]
    if not rows:
        raise RecordingError(f"{file}: found an empty file, expected a header {EXPECTED}")
    header = _header(file, lines[rows[0]], rows[0] + 1)
    layout = read_layout(header, f"{file}: line {rows[0] + 1}", n)
    body = rows[1:]
    if len(body) < 2:
        found = "one row" if body else "no rows"
        raise RecordingError(f"{file}: found {found} below the header, expected at least two")
    matrix, labels = _parse(file, lines, body, header, layout)
    order = [layout.time, *(i for indices in layout.fields.values() for i in indices)]
    column = {index: place for place, index in enumerate(order)}
    recording = Recording(
        t=matrix[:, 0],
        payload_label=labels,
        name=file.name,
        source_hash=hashlib.sha256(content).hexdigest(),
        warnings=layout_warnings(layout, file.name),
        **{
            field: matrix[:, [column[i] for i in indices]]
            for field, indices in layout.fields.items()
        },
    )
    fault = first_fault(recording)
    if fault is not None and fault.row is not None:
        line = body[fault.row] + 1
        raise RecordingError(f"{file}: line {line}, column {fault.column}: {fault}")
    return recording


def save_csv(recording: Recording, file: Path) -> None:
    """Write a CSV, or a gzipped one by suffix; numbers read back exactly."""
    columns = columns_of(recording)
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(columns)
    # tolist: Python floats are written in the shortest form that reads back exactly
    lists = [x.tolist() if isinstance(x, np.ndarray) else x for x in columns.values()]
    writer.writerows(zip(*lists, strict=True))
    content = text.getvalue().encode()
    if file.name.lower().endswith(".gz"):
        content = gzip.compress(content, mtime=0)
    with atomic_binary(file) as out:
        out.write(content)


def _text(file: Path, content: bytes) -> str:
    if file.name.lower().endswith(".gz"):
        try:
            content = gzip.decompress(content)
        except (gzip.BadGzipFile, EOFError, zlib.error) as error:
            raise RecordingError(f"{file}: not a complete gzip file ({error})") from error
    try:
        text = content.decode("utf-8-sig")
    except UnicodeDecodeError:
        text = "\0"
    if "\0" in text:
        raise RecordingError(f"{file}: found binary data, expected a CSV")
    return text


def _header(file: Path, line: str, number: int) -> list[str]:
    names = [name.strip() for name in next(csv.reader([line]))]
    if "t" in names:
        return names
    where = f"{file}: line {number}"
    for separator, title in ((";", "semicolons"), ("\t", "tabs")):
        if "t" in [name.strip() for name in line.split(separator)]:
            raise RecordingError(f"{where}: found {title} between columns, expected commas")
    if all(_is_number(name) for name in names):
        raise RecordingError(f"{where}: found numbers, expected a header {EXPECTED}")
    return names


def _parse(
    file: Path, lines: list[str], body: list[int], header: list[str], layout: Layout
) -> tuple[Array, tuple[str, ...] | None]:
    order = [layout.time, *(i for indices in layout.fields.values() for i in indices)]
    commas = lines[body[0]].count(",")
    if layout.label is None and any(lines[k].count(",") != commas for k in body):
        raise _locate(file, lines, body, header, set(order))
    try:
        matrix = np.loadtxt(
            (lines[k] for k in body),
            delimiter=",",
            comments=None,
            quotechar='"',
            usecols=order,
            ndmin=2,
        )
    except ValueError:
        raise _locate(file, lines, body, header, set(order)) from None
    if matrix.shape[0] != len(body):
        raise _locate(file, lines, body, header, set(order))
    if layout.label is None:
        return matrix, None
    cells = list(csv.reader(lines[k] for k in body))
    if any(len(row) != len(header) for row in cells):
        raise _locate(file, lines, body, header, set(order))
    return matrix, tuple(row[layout.label].strip() for row in cells)


def _locate(
    file: Path, lines: list[str], body: list[int], header: list[str], numeric: set[int]
) -> RecordingError:
    """The error of the first cell that is no number, or the first row of another length."""
    for k in body:
        cells = next(csv.reader([lines[k]]))
        where = f"{file}: line {k + 1}"
        for index, cell in enumerate(cells[: len(header)]):
            if index in numeric and not _is_number(cell):
                found = shorten(cell.strip()) if cell.strip() else "an empty cell"
                return RecordingError(
                    f"{where}, column {header[index]}: found {found}, expected a number"
                )
        if len(cells) != len(header):
            column = header[min(len(cells), len(header) - 1)]
            return RecordingError(
                f"{where}, column {column}: found {len(cells)} columns, "
                f"expected {len(header)} as in the header"
            )
    return RecordingError(f"{file}: not a CSV that numbers can be read from, expected {EXPECTED}")


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return "_" not in text
