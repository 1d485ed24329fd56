"""Files of recordings: what is saved is read back, parts, names of columns, large files."""

import hashlib

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from recording.planar_arm import measured

from lieid_casadi.errors import (
    ColumnNamesWarning,
    LargeFileWarning,
    OutputError,
    RecordingError,
    UnknownColumnWarning,
)
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
    import pandas as pd  # takes half a second

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


JOINTS = ["shoulder_pan_joint", "elbow_joint"]


@pytest.fixture
def rec():
    return measured(duration=4.0, rate=50.0)


def written(rec, folder, names, suffix="csv", **more):
    """A file with columns under given names; {j} is the joint's number from 1, {k} from 0."""
    columns = {}
    for name, values in names.items():
        for j in range(1 if values.ndim == 1 else rec.n):
            column = name.format(j=j + 1, k=j, name=JOINTS[j])
            columns[column] = values if values.ndim == 1 else values[:, j]
    columns |= more
    file = folder / f"run.{suffix}"
    if suffix == "npz":
        np.savez(file, **{name.replace("/", "."): x for name, x in columns.items()})
    elif suffix == "parquet":
        pa = pytest.importorskip("pyarrow")
        pytest.importorskip("pyarrow.parquet").write_table(pa.table(columns), file)
    else:
        table = np.column_stack(list(columns.values()))
        file.write_text(
            ",".join(columns) + "\n" + "\n".join(",".join(map(repr, row)) for row in table.tolist())
        )
    return file


def assert_signals(read, rec):
    for field in ("t", "q", "dq", "tau"):
        np.testing.assert_array_equal(getattr(read, field), getattr(rec, field))


@pytest.mark.parametrize("suffix", ["csv", "npz", "parquet"])
@pytest.mark.parametrize(
    "names",
    [
        ("time", "position_{j}", "velocity_{j}", "effort_{j}"),
        ("timestamp", "actual_q_{k}", "actual_qd_{k}", "actual_torque_{k}"),
        ("t", "q_{k}", "dq_{k}", "tau_J_{k}"),
        ("time", "{name}/position", "{name}/velocity", "{name}/effort"),
        ("t", "joint{j}Position", "joint{j}Velocity", "joint{j}Torque"),
        ("__time", "/joint_states/{name}/position", "/states/{name}/velocity", "/{name}/effort"),
        ("%time", "field.position{k}", "field.velocity{k}", "field.effort{k}"),
    ],
)
def test_names_of_recorders_are_read_and_said(rec, tmp_path, names, suffix):
    file = written(
        rec, tmp_path, dict(zip(names, (rec.t, rec.q, rec.dq, rec.tau), strict=True)), suffix
    )
    read = Recording.load(file, joint_names=JOINTS)
    assert_signals(read, rec)
    (warning,) = read.warnings
    assert isinstance(warning, ColumnNamesWarning)
    assert "dq1 = " in str(warning)


def test_units_of_the_format_behind_names(rec, tmp_path):
    names = ("t [s]", "q{j} [rad]", "dq{j} (rad/s)", "tau{j} [Nm]")
    signals = (rec.t, rec.q, rec.dq, rec.tau)
    assert_signals(
        Recording.load(written(rec, tmp_path, dict(zip(names, signals, strict=True)))), rec
    )
    other = {"t [s]": rec.t, "q{j} [deg]": rec.q}
    with pytest.raises(RecordingError, match=r"--columns NAME=COLUMN"):
        Recording.load(written(rec, tmp_path, other))


@pytest.mark.parametrize(
    "names",
    [
        ("time", "position_{j}", "pos_{j}"),  # two columns for one signal
        ("time", "position_{j}", "torque_{k}"),  # from 0 and from 1
        ("time", "{name}_x", "{name}_y"),
        ("when", "position_{j}", "effort_{j}"),
    ],
)
def test_ambiguous_names_are_refused_with_the_option(rec, tmp_path, names):
    file = written(rec, tmp_path, dict(zip(names, (rec.t, rec.q, rec.tau), strict=True)))
    with pytest.raises(RecordingError, match=r"--columns NAME=COLUMN"):
        Recording.load(file)


def test_commanded_positions_and_other_signals(rec, tmp_path):
    names = {"timestamp": rec.t, "actual_q_{k}": rec.q, "target_q_{k}": rec.q + 0.1}
    names |= {"target_moment_{k}": rec.tau, "tau_ext_{k}": rec.tau}
    read = Recording.load(written(rec, tmp_path, names))
    np.testing.assert_array_equal(read.command, rec.q + 0.1)
    assert read.tau is None
    assert any(
        isinstance(w, UnknownColumnWarning) and "target_moment_0" in str(w) for w in read.warnings
    )


@pytest.mark.parametrize("suffix", ["csv", "npz", "parquet"])
@pytest.mark.parametrize(
    "stated",
    [
        "t=stamp,q1=alpha,q2=beta,dq=w*,tau=m *x",
        {"t": "stamp", "q1": "alpha", "q2": "beta", "dq": "w*", "tau1": "m 7x", "tau2": "m 12x"},
    ],
)
def test_stated_columns(rec, tmp_path, suffix, stated):
    more = {"alpha": rec.q[:, 0], "beta": rec.q[:, 1], "q1": rec.q[:, 1], "w10": rec.dq[:, 1]}
    more |= {"w9": rec.dq[:, 0], "m 7x": rec.tau[:, 0], "m 12x": rec.tau[:, 1]}
    read = Recording.load(written(rec, tmp_path, {"stamp": rec.t}, suffix, **more), columns=stated)
    assert_signals(read, rec)
    (warning,) = read.warnings
    assert "q1 of the file" in str(warning)


def test_stated_columns_of_data_frames_and_whole_arrays(rec, tmp_path):
    import pandas as pd

    frame = pd.DataFrame({"s": rec.t, "a": rec.q[:, 0], "b": rec.q[:, 1]})
    read = Recording.from_dataframe(frame, columns="t=s,q1=a,q2=b")
    np.testing.assert_array_equal(read.q, rec.q)
    np.savez(tmp_path / "run.npz", s=rec.t, angles=rec.q, velocity=rec.dq, effort=rec.tau)
    read = Recording.load(tmp_path / "run.npz", columns="t=s,q=angles,dq=velocity,tau=effort")
    assert_signals(read, rec)


@pytest.mark.parametrize(
    ("stated", "message"),
    [
        ("t=none", "no column 'none'"),
        ("tau1", "found 'tau1=', expected NAME=COLUMN"),
        ("torque=tau1", "found 'torque=tau1', expected NAME=COLUMN"),
        ("q1=q1,q1=q2", "found q1 twice"),
        ("q=*x", r"no column '\*x'"),
    ],
)
def test_what_cannot_be_assigned_is_refused(rec, tmp_path, stated, message):
    rec.save(tmp_path / "run.csv")
    with pytest.raises(RecordingError, match=message):
        Recording.load(tmp_path / "run.csv", columns=stated)


def test_an_npz_has_the_names_of_a_csv_or_whole_arrays(rec, tmp_path):
    written(rec, tmp_path, {"t": rec.t, "q{j}": rec.q, "dq{j}": rec.dq, "tau{j}": rec.tau}, "npz")
    read = Recording.load(tmp_path / "run.npz")
    assert_signals(read, rec)
    assert not read.warnings
    np.savez(tmp_path / "both.npz", t=rec.t, q=rec.q, dq1=rec.dq[:, 0], dq2=rec.dq[:, 1])
    np.testing.assert_array_equal(Recording.load(tmp_path / "both.npz").dq, rec.dq)


def test_one_arm_of_a_file_with_two(tmp_path):
    t = np.arange(0.0, 1.0, 0.01)
    names = [f"{prefix}{joint}" for prefix in ("q", "dq", "tau") for joint in range(1, 5)]
    values = np.random.default_rng(0).normal(size=(len(t), 12))
    header, file = ",".join(["t", *names]), tmp_path / "both.csv"
    np.savetxt(file, np.column_stack([t, values]), delimiter=",", header=header, comments="")
    for first in (1, 3):
        own = ",".join(f"{x}{k}={x}{first + k - 1}" for x in ("q", "dq", "tau") for k in (1, 2))
        arm = Recording.load(file, n=2, columns=own)
        of_joints = np.column_stack([arm.q, arm.dq, arm.tau])
        here = [k for k in range(12) if k % 4 in (first - 1, first)]
        np.testing.assert_allclose(of_joints, values[:, here])
    with pytest.raises(RecordingError, match=r"q1…q2 are stated, that of dq1 is not"):
        Recording.load(file, n=2, columns="q1=q3,q2=q4")
    with pytest.raises(RecordingError, match=r"found 4 joints .*expected 2"):
        Recording.load(file, n=2)
