import gzip
import hashlib

import numpy as np
import pandas as pd
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from recording.planar_arm import measured

from lieid_casadi.errors import OutputError, RecordingError, UnknownColumnWarning
from lieid_casadi.recording import Recording

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


def test_more_than_nine_joints_are_ordered_by_number(tmp_path):
    file = tmp_path / "run.csv"
    joints = [f"q{j}" for j in range(1, 12)]
    rows = [",".join(["t", *reversed(joints)]), ",".join(map(str, range(12)))]
    file.write_text("\n".join([*rows, ",".join(map(str, range(1, 13)))]))
    np.testing.assert_array_equal(Recording.load(file).q[0], np.arange(11, 0, -1))


def test_byte_order_mark_and_windows_line_ends(tmp_path):
    file = tmp_path / "run.csv"
    file.write_bytes(b"\xef\xbb\xbft,q1\r\n0,1\r\n1,2\r\n")
    np.testing.assert_array_equal(Recording.load(file).q[:, 0], [1, 2])


def test_unknown_columns_are_left_aside_and_named(tmp_path):
    file = tmp_path / "run.csv"
    file.write_text("t,q1,voltage\n0,1,x\n1,2,y\n")
    recording = Recording.load(file)
    (warning,) = recording.warnings
    assert isinstance(warning, UnknownColumnWarning)
    assert "voltage" in str(warning)


def test_currents_become_torques_where_there_are_none(tmp_path):
    file = tmp_path / "run.csv"
    file.write_text("t,q1,q2,i1,i2\n0,0,0,1,2\n1,0,0,3,-4\n")
    assert Recording.load(file).tau is None
    recording = Recording.load(file, torque_constants=[10, 0.5])
    np.testing.assert_array_equal(recording.tau, [[10, 1], [30, -2]])
    np.testing.assert_array_equal(recording.current, [[1, 2], [3, -4]])
    with pytest.raises(RecordingError, match="3 torque constants, expected 2"):
        Recording.load(file, torque_constants=[1, 2, 3])


def test_measured_torque_is_kept_before_that_of_currents():
    recording = measured(current=np.ones((4800, 2)), torque_constants=[5.0, 5.0])
    np.testing.assert_array_equal(recording.tau, measured().tau)
    np.testing.assert_array_equal(recording.with_torque_constants([5, 7]).tau[0], [5, 7])


@pytest.mark.parametrize("constants", [[1.0, np.nan], [1.0, 0.0], [1.0]])
def test_torque_constants_must_be_one_number_per_joint(constants):
    recording = measured(current=np.ones((4800, 2)))
    with pytest.raises(RecordingError, match="torque constant"):
        recording.with_torque_constants(constants)


def test_torque_constants_without_currents():
    with pytest.raises(RecordingError, match="no motor currents"):
        measured().with_torque_constants([1, 1])


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


def test_an_archive_with_pickled_objects_is_refused(tmp_path):
    file = tmp_path / "run.npz"
    np.savez(file, t=np.arange(2.0), q=np.array([[object()], [object()]]))
    with pytest.raises(RecordingError, match="array q holds object"):
        Recording.load(file)


def test_archive_faults(tmp_path):
    file = tmp_path / "run.npz"
    np.savez(file, t=np.arange(2.0))
    with pytest.raises(RecordingError, match=r"found t, expected arrays t \(N,\), q"):
        Recording.load(file)
    np.savez(file, t=np.arange(2.0), q=np.array([["a"], ["b"]]))
    with pytest.raises(RecordingError, match="array q holds <U1, expected real numbers"):
        Recording.load(file)
    np.savez(file, t=np.arange(2.0), q=np.zeros((2, 6)))
    with pytest.raises(RecordingError, match="found 6 joints in q, expected 7"):
        Recording.load(file, n=7)
    file.write_bytes(file.read_bytes()[:50])
    with pytest.raises(RecordingError, match="not an NPZ"):
        Recording.load(file)


def test_parquet_faults(tmp_path):
    file = tmp_path / "run.parquet"
    file.write_text("t,q1\n")
    with pytest.raises(RecordingError, match="not a Parquet file"):
        Recording.load(file)
    pd.DataFrame({"t": [0.0, 1.0], "q1": [0.0, None]}).to_parquet(file)
    with pytest.raises(RecordingError, match="row 2, column q1: found nan"):
        Recording.load(file)
    pd.DataFrame({"t": [0.0, 1.0], "q2": [0.0, 1.0]}).to_parquet(file)
    with pytest.raises(RecordingError, match="column q1 is missing"):
        Recording.load(file)


def test_gzip_is_written_without_a_time_stamp(tmp_path):
    one, two = tmp_path / "one.csv.gz", tmp_path / "two.csv.gz"
    measured(duration=1).save(one)
    measured(duration=1).save(two)
    assert one.read_bytes() == two.read_bytes()
    assert gzip.decompress(one.read_bytes()).startswith(b"t,q1,q2,dq1,dq2,tau1,tau2\n")


def test_saving_elsewhere_fails_in_one_line(tmp_path):
    with pytest.raises(RecordingError, match=r"expected \.csv"):
        measured(duration=1).save(tmp_path / "run.txt")
    (tmp_path / "file").write_text("")
    with pytest.raises(OutputError, match="cannot be written"):
        measured(duration=1).save(tmp_path / "file" / "run.csv")


def test_a_failed_save_leaves_the_old_file(tmp_path, monkeypatch):
    file = tmp_path / "run.npz"
    measured(duration=1).save(file)
    before = file.read_bytes()

    def interrupted(out, **arrays):
        out.write(b"half")
        raise KeyboardInterrupt

    monkeypatch.setattr(np, "savez_compressed", interrupted)
    with pytest.raises(KeyboardInterrupt):
        measured(duration=2).save(file)
    assert file.read_bytes() == before
    assert [p.name for p in tmp_path.iterdir()] == ["run.npz"]
