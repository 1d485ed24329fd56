"""Files that inflate without bound, or whose structure states what their bytes do not hold."""

import gzip
import os
import re
import tracemalloc
import zipfile

import numpy as np
import pyarrow
import pyarrow.parquet
import pytest
from recording.planar_arm import measured

from lieid_casadi.errors import RecordingError, UnknownColumnWarning
from lieid_casadi.recording import Recording
from lieid_casadi.recording.readers import csv_file, npz_file, registry


@pytest.fixture(scope="module")
def run():
    return measured(duration=4.0, rate=50.0)


def refused(file, **options):
    with pytest.raises(RecordingError) as caught:
        Recording.load(file, **options)
    assert "\n" not in str(caught.value)
    return str(caught.value)


def test_a_gzip_bomb_takes_no_memory(tmp_path, monkeypatch):
    monkeypatch.setattr(registry, "INFLATE_LIMIT", 1 << 17)
    file = tmp_path / "run.csv.gz"
    rows = b"".join(b"%d,1\n" % k for k in range(1000))
    with gzip.open(file, "wb", compresslevel=1) as out:
        out.write(b"t,q1\n")
        for _ in range(500):
            out.write(rows)
    tracemalloc.start()
    try:
        assert "inflates to more than" in refused(file)
        _, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert peak < 2 << 20


def test_arrays_with_unknown_names_are_not_inflated(tmp_path, run):
    file = tmp_path / "run.npz"
    run.save(file)
    with zipfile.ZipFile(file, "a", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("video.npy", bytes(1 << 24))
    tracemalloc.start()
    try:
        recording = Recording.load(file)
        _, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert peak < 4 << 20
    assert [type(w) for w in recording.warnings] == [UnknownColumnWarning]
    assert "video" in str(recording.warnings[0])


def test_what_decodes_to_far_more_than_its_size(tmp_path, run, monkeypatch):
    monkeypatch.setattr(registry, "INFLATE_LIMIT", 1 << 20)
    file = tmp_path / "run.parquet"
    constant = pyarrow.array(np.zeros(500_000))
    pyarrow.parquet.write_table(pyarrow.table({"t": constant, "q1": constant}), file)
    assert "inflates to more than 1 MiB" in refused(file)
    np.savez_compressed(tmp_path / "run.npz", t=np.arange(200_000.0), q1=np.zeros(200_000))
    assert "inflates to more than 1 MiB" in refused(tmp_path / "run.npz")
    monkeypatch.setattr(registry, "INFLATE_LIMIT", 16)
    run.save(file)
    assert len(Recording.load(file)) == len(run)  # of plausible size


def test_gzipped_text_that_inflates_to_far_more_than_its_size(tmp_path, run, monkeypatch):
    """Blank lines, and rows that compress as no measurement does, are refused before the limit."""
    monkeypatch.setattr(csv_file, "UNSUSPICIOUS", 1 << 16)
    monkeypatch.setattr(csv_file, "MOST_BLANK", 1000)
    rows, blank = tmp_path / "rows.csv.gz", tmp_path / "blank.csv.gz"
    rows.write_bytes(gzip.compress(b"t,q1\n" + b"1,2\n" * (1 << 18)))
    blank.write_bytes(gzip.compress(b"t,q1\n" + b"\n" * 2000))
    assert "store it uncompressed, or in parts" in refused(rows)
    assert "found 1001 blank lines" in refused(blank)
    run.save(tmp_path / "run.csv.gz")
    assert len(Recording.load(tmp_path / "run.csv.gz")) == len(run)


@pytest.mark.parametrize("name", ["run.csv", "run.csv.gz", "run.npz", "run.parquet", "bag"])
def test_pipes_and_names_with_a_null_character_are_refused(tmp_path, name):
    if name == "bag":
        (tmp_path / name).mkdir()
        (tmp_path / name / "metadata.yaml").write_text("a: b")
        os.mkfifo(tmp_path / name / "data.db3")
    else:
        os.mkfifo(tmp_path / name)
    assert "is a pipe or a device" in refused(tmp_path / name)
    assert "null character" in refused(f"{tmp_path}/a\0{name}")


HEADER = "t,q1,q2,tau1,tau2"
ROWS = ["0,1,2,3,4", "0.1,1,2,3,4", "0.2,1,2,3,4"]


def message(tmp_path, content, name="run.csv", **options):
    file = tmp_path / name
    file.write_bytes(content if isinstance(content, bytes) else content.encode())
    with pytest.raises(RecordingError) as caught:
        Recording.load(file, **options)
    text = str(caught.value)
    assert "\n" not in text
    assert text.startswith(str(file))
    return text.removeprefix(f"{file}: ")


def with_row(index, row):
    rows = list(ROWS)
    rows[index] = row
    return "\n".join([HEADER, *rows]) + "\n"


@pytest.mark.parametrize(
    ("content", "expected"),
    [
        (with_row(1, "0.1,1,abc,3,4"), "line 3, column q2: found 'abc', expected a number"),
        (with_row(0, "0,nan,2,3,4"), "line 2, column q1: found nan, expected a finite number"),
        (with_row(2, "0.2,1,2,-inf,4"), "line 4, column tau1: found -inf, expected a finite"),
        (with_row(1, "0.1,1,2,3"), "line 3, column tau2: found 4 columns, expected 5"),
        (
            with_row(2, "0.05,1,2,3,4"),
            "line 4, column t: found 0.05 s after 0.1 s (time goes back)",
        ),
        (with_row(2, "0.1,1,2,3,5"), "line 4, column t: found the time 0.1 s twice"),
        ("", "found an empty file, expected a header"),
        (HEADER + "\n" + ROWS[0], "found one row below the header, expected at least two"),
        ("\n".join(ROWS), "line 1: found numbers, expected a header"),
        ("<robot name='a'>\n</robot>\n", "line 1: found \"<robot name='a'>\", expected a header"),
        ("t;q1;q2\n0;1;2\n", "line 1: found semicolons between columns, expected commas"),
        ("t\tq1\n0\t1\n", "line 1: found tabs between columns, expected commas"),
        ("when,q1\n0,1\n1,2\n", "line 1: found 'when,q1', expected a header with column t"),
        ("t,q1,q1\n0,1,2\n1,2,3\n", "line 1: column 'q1' occurs twice"),
        ("t,q0,q1\n0,1,2\n1,2,3\n", "line 1: found column 'q0', expected joints from 1"),
        (b"PK\x03\x04\0\0\xff\xfe", "found binary data, expected a CSV"),
    ],
)
def test_bad_csv(tmp_path, content, expected):
    assert message(tmp_path, content).startswith(expected)


@pytest.mark.parametrize("missing", ["q3", "dq1", "tau3", "tau6", "temp2"])
def test_a_missing_column_is_named(tmp_path, missing):
    signals = ["q", "dq", "tau", "temp"]
    names = ["t", *(f"{s}{j}" for s in signals for j in range(1, 7))]
    names.remove(missing)
    rows = [",".join(str(k) for _ in names) for k in range(3)]
    text = message(tmp_path, "\n".join([",".join(names), *rows]))
    assert text.startswith(f"line 1: column {missing} is missing")
    stem = missing.rstrip("0123456789")
    assert text.endswith(f"expected {stem}1…{stem}6")


def test_a_truncated_gzip(tmp_path):
    content = gzip.compress(with_row(0, ROWS[0]).encode())
    assert message(tmp_path, content[:-12], name="run.csv.gz").startswith("not a complete gzip")
    assert message(tmp_path, b"t,q1\n", name="run.csv.gz").endswith("or the suffix .csv")


def test_missing_file_and_unknown_suffix(tmp_path):
    for name in ("run.csv", "run.csv@0:3", "run.npz", "run.txt"):
        with pytest.raises(RecordingError, match="no such file"):
            Recording.load(tmp_path / name)
    assert message(tmp_path, "", name="run.txt").startswith("found suffix '.txt', expected .csv")
    (tmp_path / "folder").mkdir()
    with pytest.raises(RecordingError, match=re.escape(str(tmp_path / "folder"))):
        Recording.load(tmp_path / "folder")
    (tmp_path / "folder.csv").mkdir()
    with pytest.raises(RecordingError, match="cannot be read"):
        Recording.load(tmp_path / "folder.csv")


def test_too_little_memory_is_not_called_a_damaged_file(tmp_path, monkeypatch):
    file = tmp_path / "run.npz"
    np.savez(file, t=np.arange(3.0))

    def load(*_):
        raise MemoryError

    monkeypatch.setattr(npz_file, "_arrays", load)
    with pytest.raises(RecordingError, match="needs more memory than is available"):
        Recording.load(file)
