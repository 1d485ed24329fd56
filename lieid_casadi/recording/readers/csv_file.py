"""Recordings as CSV, plain or gzipped."""

from __future__ import annotations

import csv
import gzip
import io
import zlib
from collections.abc import Iterator
from dataclasses import replace
from itertools import chain, islice
from pathlib import Path
from typing import IO, Any

import numpy as np

from lieid_casadi.arrays import Array
from lieid_casadi.atomic_file import atomic_binary
from lieid_casadi.errors import RecordingError
from lieid_casadi.messages import shortened
from lieid_casadi.recording.measurement import Measurement
from lieid_casadi.recording.readers import registry
from lieid_casadi.recording.readers.columns import (
    EXPECTED,
    LABEL,
    ColumnLayout,
    columns_of,
    measurement_of_columns,
    read_layout,
)
from lieid_casadi.recording.repairs import without_damaged_rows


def read_csv(file: Path, options: registry.ReadOptions) -> Measurement:
    """Read a CSV with a header."""
    first = next(numbered_lines(file), None)
    if first is None:
        raise RecordingError(f"{file}: found an empty file, expected a header {EXPECTED}")
    number, line = first
    header = _header(file, line, number)
    stated = options.n, options.columns, options.joint_names
    layout = read_layout(header, f"{file}: line {number}", *stated, title=file.name)
    rows = _Rows(file, header, layout)
    try:
        matrix = _parse(rows, layout)
    except ValueError as error:
        if isinstance(error, RecordingError):
            raise
        raise _locate(file, header, layout) from None
    if len(matrix) < 2:
        found = "one row" if len(matrix) else "no rows"
        raise RecordingError(f"{file}: found {found} below the header, expected at least two")
    columns: dict[str, Any] = dict(zip(layout.used(), matrix.T, strict=False))
    if layout.label is not None:
        columns[LABEL] = rows.labels
    measurement = replace(
        measurement_of_columns(columns, str(file)),
        name=file.name,
        source_hash=registry.hash_of_file(file),
        warnings=layout.warnings,
    )
    repaired, fault = without_damaged_rows(measurement)
    if fault is not None and rows.mended:
        raise _locate(file, header, layout)
    if fault is not None and fault.row is not None:
        bad_line, _ = next(islice(numbered_lines(file), fault.row + 1, None))
        raise RecordingError(f"{file}: line {bad_line}, column {fault.column}: {fault}")
    return repaired


def write_csv(measurement: Measurement, file: Path) -> None:
    """Write a CSV, or a gzipped one by suffix; numbers read back exactly."""
    columns = columns_of(measurement)
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


FORMAT = registry.RecordingFormat(suffixes=(".csv", ".csv.gz"), read=read_csv, write=write_csv)


def _header(file: Path, line: str, number: int) -> list[str]:
    where = f"{file}: line {number}"
    names = _cells(line)
    if names is None:
        raise RecordingError(f"{where}: found {shortened(line)}, expected a header {EXPECTED}")
    names = [name.strip() for name in names]
    if len(names) > 1 and not all(_is_number(name) for name in names):
        return names
    for separator, title in ((";", "semicolons"), ("\t", "tabs")):
        if "t" in [name.strip() for name in line.split(separator)]:
            raise RecordingError(
                f"{where}: found {title} between columns, expected commas (and a point in numbers: "
                "1.5, not 1,5)"
            )
    if all(_is_number(name) for name in names):
        raise RecordingError(f"{where}: found numbers, expected a header {EXPECTED}")
    return names


def _cells(line: str) -> list[str] | None:
    """Return the cells of a line; None where the quotes are damaged."""
    try:
        return next(csv.reader([line]))
    except csv.Error:
        return None


class _Rows:
    """The rows below the header as lines of numbers; the payload's labels are in ``labels``."""

    def __init__(self, file: Path, header: list[str], layout: ColumnLayout) -> None:
        self._file, self._columns, self._label = file, len(header), layout.label
        self.labels: list[str] = []
        self.mended = False  # whether empty cells, and rows that end early, were read as NaN

    def __iter__(self) -> Iterator[str]:
        lines = numbered_lines(self._file)
        next(lines)  # the header
        for _, line in lines:
            full = self._label is None and line.count(",") + 1 == self._columns
            ends = line[0] != "," and line[-1] != ","
            plain = full and ends and not any(text in line for text in (",,", '"', " "))
            yield line if plain else self._mended(line)

    def _mended(self, line: str) -> str:
        """Return a row with NaN in empty cells, and in all cells if it ends early."""
        cells = _cells(line)
        if cells is None or len(cells) > self._columns:
            raise ValueError
        if self._label is not None:
            self.labels.append(cells[self._label].strip() if self._label < len(cells) else "")
        if len(cells) < self._columns:
            cells = [""] * self._columns
        if self._label is not None:
            cells[self._label] = "0"
        self.mended |= not all(cell.strip() for cell in cells)
        return ",".join(cell if cell.strip() else "nan" for cell in cells)


def _parse(rows: _Rows, layout: ColumnLayout) -> Array:
    """Return the numbers (N, columns) in the order of `ColumnLayout.numeric`."""
    source = iter(rows)
    first = next(source, None)
    if first is None:
        return np.empty((0, len(layout.numeric)))
    lines = chain([first], source)
    return np.loadtxt(lines, delimiter=",", comments=None, usecols=layout.numeric, ndmin=2)


def _locate(file: Path, header: list[str], layout: ColumnLayout) -> RecordingError:
    """Return the error of the first cell that is no number, or the first row of another length."""
    numeric = set(layout.numeric)
    lines = numbered_lines(file)
    next(lines)
    for number, line in lines:
        where = f"{file}: line {number}"
        cells = _cells(line)
        if cells is None:
            return RecordingError(f"{where}: found damaged quotes, expected a CSV")
        for index, cell in enumerate(cells[: len(header)]):
            if index in numeric and not _is_number(cell):
                found, expected = shortened(cell.strip()), "a number"
                if not cell.strip():
                    found = "an empty cell"
                    expected += "; delete the rows or columns without a measurement"
                elif index == layout.time:
                    expected += ", the time in seconds"
                return RecordingError(
                    f"{where}, column {header[index]}: found {found}, expected {expected}"
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
    return "_" not in text and text.isascii()


#: Longest line, characters; some 100,000 columns.
LONGEST_LINE = 1 << 22
MOST_BLANK = 100_000  # lines
#: Largest ratio of inflated to stored size of a gzipped file of this size, bytes, and more.
LARGEST_RATIO, UNSUSPICIOUS = 100, 1 << 24


def numbered_lines(file: Path) -> Iterator[tuple[int, str]]:
    """Yield number (from 1) and text of each line that is not blank."""
    with file.open("rb") as raw:
        binary: IO[bytes] = raw
        if file.name.lower().endswith(".gz"):
            binary = io.BytesIO(_inflated(raw, file))
        text = io.TextIOWrapper(binary, encoding="utf-8-sig")
        number = blank = 0
        while line := _next_line(text, file, number + 1):
            number += 1
            if line.strip():
                yield number, line.rstrip("\r\n")
                continue
            blank += 1
            if blank > MOST_BLANK:
                raise RecordingError(f"{file}: found {blank} blank lines, expected a CSV")


def _inflated(raw: IO[bytes], file: Path) -> bytes:
    limit = min(registry.INFLATE_LIMIT, max(UNSUSPICIOUS, LARGEST_RATIO * file.stat().st_size))
    try:
        content = gzip.GzipFile(fileobj=raw).read(limit + 1)
    except (gzip.BadGzipFile, EOFError, zlib.error) as error:
        raise RecordingError(
            f"{file}: not a complete gzip file ({error}); expected gzip, or the suffix .csv"
        ) from error
    if len(content) > limit:
        raise registry.beyond_limit(file, limit)
    return content


def _next_line(text: IO[str], file: Path, number: int) -> str:
    try:
        line = text.readline(LONGEST_LINE)
    except UnicodeDecodeError:
        line = "\0"
    if "\0" in line:
        raise RecordingError(f"{file}: found binary data, expected a CSV")
    if len(line) >= LONGEST_LINE:
        raise RecordingError(
            f"{file}: line {number}: found more than {LONGEST_LINE} characters, expected a CSV"
        )
    return line
