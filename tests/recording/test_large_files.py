"""Parquet files larger than the memory: means of a few rows are read."""

import numpy as np
import pytest

from lieid_casadi.errors import LargeFileWarning
from lieid_casadi.recording import Recording
from lieid_casadi.recording.readers import parquet_file

pq = pytest.importorskip("pyarrow.parquet")
ROWS, COLUMNS = 20_000, 7


@pytest.fixture(params=[700, 1 << 20])
def large(tmp_path, monkeypatch, request):
    """A file eight times as large as what a recording may take, with its content."""
    t = np.arange(ROWS) * 0.001
    t[9000:] += 1.0
    q = np.sin(np.outer(t, [1.0, 2.0]))
    made = Recording.from_arrays(
        t, q, np.cos(q), 3.0 * q, load=["a"] * 14_000 + ["b"] * (ROWS - 14_000)
    )
    path = tmp_path / "large.parquet"
    made.save(path)
    pq.write_table(pq.read_table(path), path, row_group_size=request.param)
    monkeypatch.setattr(parquet_file, "memory_bytes", lambda: 8 * ROWS * (COLUMNS + 1))
    return path, made


def test_rows_are_means_that_span_no_gap_and_no_payload(large):
    path, made = large
    read = Recording.load(path)
    assert 0.9 * ROWS / 8 < len(read) < 1.2 * ROWS / 8
    assert [type(w) for w in read.warnings] == [LargeFileWarning]
    assert "mean of 8 rows" in str(read.warnings[0])
    assert [s.payload_label[0] for s in read.segments()] == ["a", "a", "b"]
    # a block that spanned the gap or the change would have its mean time between the two
    for start, end in [(0.0, 8.999), (10.0, 14.999), (15.0, 20.999)]:
        inside = read.cut(start, end + 1e-9)
        np.testing.assert_allclose(inside.q, np.sin(np.outer(inside.t, [1.0, 2.0])), atol=1e-4)
        np.testing.assert_allclose(inside.tau, 3.0 * inside.q, atol=1e-12)
    assert read.source_hash == made.source_hash or len(read.source_hash) == 64


def test_a_part_is_read_at_its_full_rate(large):
    path, made = large
    part = Recording.load(f"{path}@2:3.5")
    np.testing.assert_array_equal(part.t, made.cut(2.0, 3.5).t)
    np.testing.assert_array_equal(part.tau, made.cut(2.0, 3.5).tau)
    assert not part.warnings
