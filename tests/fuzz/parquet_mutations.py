"""Mutations of Parquet files: other columns, types and encodings, and damaged bytes."""

from __future__ import annotations

import io
import random

import pyarrow
import pyarrow.compute
import pyarrow.parquet
from fuzz import seeds
from fuzz.text_mutations import mutate_bytes

#: Types that a column is converted to.
TYPES = (
    pyarrow.string(), pyarrow.int8(), pyarrow.int64(), pyarrow.float32(), pyarrow.bool_(),
    pyarrow.decimal128(38, 3), pyarrow.timestamp("ns"), pyarrow.date32(), pyarrow.binary(),
    pyarrow.dictionary(pyarrow.int32(), pyarrow.string()), pyarrow.large_string(),
)  # fmt: skip
NAMES = ("t", "q1", "q2", "dq1", "tau1", "load", "temp1", "i1", "x", "", "q99999", "q0")


def mutate_parquet(data: bytes, rng: random.Random) -> bytes:
    """Return a valid Parquet file with another column; damaged files get damaged bytes only.

    A damaged file is never decoded here, where nothing limits time and memory.
    """
    if data not in seeds.parquet():
        return mutate_bytes(data, rng)
    table = pyarrow.parquet.read_table(pyarrow.BufferReader(data))
    try:
        table = _changed(table, rng)
    except (pyarrow.ArrowException, ValueError, TypeError, OverflowError):
        return mutate_bytes(data, rng)
    out = io.BytesIO()
    try:
        pyarrow.parquet.write_table(
            table,
            out,
            compression=rng.choice(("none", "snappy", "gzip", "zstd", "lz4", "brotli")),
            row_group_size=rng.choice((1, 7, 1000)),
            use_dictionary=rng.random() < 0.5,
            version=rng.choice(("1.0", "2.6")),
            data_page_size=rng.choice((16, 1 << 20)),
        )
    except (pyarrow.ArrowException, ValueError):
        return mutate_bytes(data, rng)
    return out.getvalue()


def _changed(table: pyarrow.Table, rng: random.Random) -> pyarrow.Table:
    """Return a table with one column or some rows changed."""
    k = rng.randrange(table.num_columns)
    name, column = table.column_names[k], table.column(k)
    kind = rng.randrange(7)
    if kind == 0:
        return table.set_column(k, rng.choice(NAMES), column)
    if kind == 1:
        return table.append_column(rng.choice(NAMES), column)
    if kind == 2:
        return table.remove_column(k)
    if kind == 3:
        return table.slice(rng.randrange(3), rng.choice((0, 1, 2, 40)))
    if kind == 4:
        return table.set_column(k, name, column.cast(rng.choice(TYPES), safe=False))
    if kind == 5:
        factor = 10.0 ** rng.choice((-300, -9, -3, 3, 6, 9, 300))
        return table.set_column(k, name, pyarrow.compute.multiply(column, factor))
    values = column.to_pylist()
    values[rng.randrange(len(values))] = rng.choice((None, float("nan"), float("inf"), 1e300))
    return table.set_column(k, name, pyarrow.array(values))
