import hashlib

import numpy as np
import pandas as pd
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from recording.planar_arm import measured

from lieid_casadi.errors import LargeFileWarning, OutputError, RecordingError
from lieid_casadi.recording import Recording, process
from lieid_casadi.recording.readers import parquet_file

FORMATS = ["csv", "csv.gz", "npz", "parquet"]
FIELDS = ["t", "q", "dq", "tau", "ddq", "temperature", "current"]


def assert_same(one, other):
    for field in FIELDS:
        first, second = getattr(one, field), getattr(other, field)
        assert (first is None) == (second is None), field
        if first is not None:
            np.testing.assert_array_equal(first, second, err_msg=field)
    assert one.payload_label == other.payload_label


@st.composite
def any_recording(draw):
    n, rows = draw(st.integers(1, 4)), draw(st.integers(2, 6))
    numbers = st.floats(-1e6, 1e6, allow_nan=False, allow_infinity=False)
    steps = draw(arrays(float, rows, elements=st.floats(1e-4, 10.0)))

    def signal():
        return draw(arrays(float, (rows, n), elements=numbers))

    optional = {
        field: signal()
        for field in ["dq", "tau", "ddq", "temperature", "current"]
        if draw(st.booleans())
    }
    words = st.text("abcdefgh 0123.,'\"", max_size=6).map(str.strip)
    load = draw(st.none() | st.lists(words, min_size=rows, max_size=rows))
    return Recording.from_arrays(np.cumsum(steps), signal(), load=load, **optional)


@pytest.mark.parametrize("suffix", FORMATS)
@given(recording=any_recording())
@settings(max_examples=25, suppress_health_check=list(HealthCheck), deadline=None)
def test_a_saved_recording_loads_back_exactly(recording, suffix, tmp_path):
    file = tmp_path / f"run.{suffix}"
    recording.save(file)
    back = Recording.load(file)
    assert_same(recording, back)
    assert back.source_hash == hashlib.sha256(file.read_bytes()).hexdigest()
    assert back.name == file.name
    assert [p.name for p in tmp_path.iterdir()] == [file.name]  # nothing half-written beside it


def test_columns_in_any_order_with_spaces_and_quotes(tmp_path):
    file = tmp_path / "run.csv"
    file.write_text('tau2, q1 ,"t",q2,load,tau1\n4,1,0,2,"a, b",3\n40,10,0.5,20,c,30\n\n')
    recording = Recording.load(file)
    np.testing.assert_array_equal(recording.t, [0, 0.5])
    np.testing.assert_array_equal(recording.q, [[1, 2], [10, 20]])
    np.testing.assert_array_equal(recording.tau, [[3, 4], [30, 40]])
    assert recording.payload_label == ("a, b", "c")
    assert recording.dq is None
    assert recording.warnings == ()


def test_currents_become_torques_where_there_are_none(tmp_path):
    file = tmp_path / "run.csv"
    file.write_text("t,q1,q2,i1,i2\n0,0,0,1,2\n1,0,0,3,-4\n")
    assert Recording.load(file).tau is None
    recording = Recording.load(file, torque_constants=[10, 0.5])
    np.testing.assert_array_equal(recording.tau, [[10, 1], [30, -2]])
    np.testing.assert_array_equal(recording.current, [[1, 2], [3, -4]])
    with pytest.raises(RecordingError, match="3 torque constants, expected 2"):
        Recording.load(file, torque_constants=[1, 2, 3])


def test_data_frame():
    frame = pd.DataFrame({"tau1": [5, 6], "q1": [1.0, 2.0], "t": [0, 1], "load": ["a", "b"]})
    recording = Recording.from_dataframe(frame, name="frame")
    np.testing.assert_array_equal(recording.tau, [[5], [6]])
    assert recording.payload_label == ("a", "b")
    assert recording.source_hash
    with pytest.raises(RecordingError, match=r"column q1, row 2: found 'x', expected a number"):
        Recording.from_dataframe(frame.assign(q1=[1, "x"]))


def test_arrays_cannot_be_changed_and_hash_tells_them_apart():
    q = np.zeros((3, 2))
    recording = Recording.from_arrays([0, 1, 2], q)
    q[0] = 1.0
    assert recording.q[0, 0] == 0.0
    with pytest.raises(ValueError, match="read-only"):
        recording.q[0] = 1.0
    assert recording.source_hash != Recording.from_arrays([0, 1, 2], q).source_hash


@pytest.mark.parametrize(
    ("field", "values", "message"),
    [
        ("q", np.zeros(3), "q has shape"),
        ("q", np.zeros((2, 2)), "q has shape"),
        ("tau", np.zeros((3, 3)), "tau has shape"),
        ("load", ["a"], "1 load labels for 3 rows"),
        ("t", np.zeros((3, 1)), "t has shape"),
    ],
)
def test_shapes_that_do_not_fit(field, values, message):
    arguments = {"t": [0, 1, 2], "q": np.zeros((3, 2)), field: values}
    with pytest.raises(RecordingError, match=message):
        Recording.from_arrays(**arguments)


def test_archive_faults(tmp_path):
    file = tmp_path / "run.npz"
    np.savez(file, t=np.arange(2.0))
    with pytest.raises(RecordingError, match=r"found t, expected arrays t \(N,\), q"):
        Recording.load(file)
    np.savez(file, t=np.arange(2.0), q=np.array([["a"], ["b"]]))
    with pytest.raises(RecordingError, match="array q holds <U1, expected real numbers"):
        Recording.load(file)
    np.savez(file, t=np.arange(2.0), q=np.zeros((2, 6)))
    with pytest.raises(RecordingError, match=r"found 6 joints \(q1…q6\), expected 7"):
        Recording.load(file, n=7)
    file.write_bytes(file.read_bytes()[:50])
    with pytest.raises(RecordingError, match="not an NPZ"):
        Recording.load(file)


def test_saving_elsewhere_fails_in_one_line(tmp_path):
    with pytest.raises(RecordingError, match=r"expected \.csv"):
        measured(duration=1).save(tmp_path / "run.txt")
    (tmp_path / "file").write_text("")
    with pytest.raises(OutputError, match="cannot be written"):
        measured(duration=1).save(tmp_path / "file" / "run.csv")


# -- Options of the command line for reading and processing recordings --


@pytest.fixture
def run(tmp_path):
    file = tmp_path / "run.csv"
    measured(duration=10, rate=100).save(file)
    return file


@pytest.mark.parametrize(
    ("part", "first", "last"),
    [("@2:5", 2.0, 4.99), ("@:3", 0.0, 2.99), ("@4.5:", 4.5, 9.99), ("@:", 0, 9.99), ("", 0, 9.99)],
)
def test_part_of_a_file(run, part, first, last):
    recording = Recording.load(f"{run}{part}")
    assert recording.t[0] == pytest.approx(first)
    assert recording.t[-1] == pytest.approx(last)
    whole = Recording.load(run)
    assert recording.source_hash == whole.source_hash
    inside = (whole.t >= first) & (whole.t <= last)
    np.testing.assert_array_equal(recording.tau, whole.tau[inside])


@pytest.mark.parametrize(
    ("part", "expected"),
    [
        ("@5:2", "expected T0 < T1"),
        ("@a:2", "found 'a' after @"),
        ("@nan:", "found 'nan' after @"),
        ("@20:30", "0 rows in that part, expected some of 0 to 9.99 s"),
        ("@1:1.005", "1 rows in that part"),
    ],
)
def test_bad_part(run, part, expected):
    with pytest.raises(RecordingError, match=expected):
        Recording.load(f"{run}{part}")


def test_segments_end_where_the_payload_changes():
    label = ["none"] * 1000 + ["2 kg"] * 1000
    recording = measured(duration=10, rate=200, load=label)
    assert [s.payload_label[0] for s in recording.segments()] == ["none", "2 kg"]
    assert [p.payload_label for p in process(recording)] == ["none", "2 kg"]


# -- Parquet files larger than the memory: means of a few rows are read --


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
