"""Columns under other names: stated by the user, or unambiguous names of recorders."""

import numpy as np
import pytest
from recording.planar_arm import measured

from lieid_casadi.errors import ColumnNamesWarning, RecordingError, UnknownColumnWarning
from lieid_casadi.recording import Recording

JOINTS = ["shoulder_pan_joint", "elbow_joint"]


@pytest.fixture
def run():
    return measured(duration=4.0, rate=50.0)


def written(run, folder, names, suffix="csv", **more):
    """A file with columns under given names; {j} is the joint's number from 1, {k} from 0."""
    columns = {}
    for name, values in names.items():
        for j in range(1 if values.ndim == 1 else run.n):
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


def assert_same(read, run):
    for field in ("t", "q", "dq", "tau"):
        np.testing.assert_array_equal(getattr(read, field), getattr(run, field))


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
def test_names_of_recorders_are_read_and_said(run, tmp_path, names, suffix):
    file = written(
        run, tmp_path, dict(zip(names, (run.t, run.q, run.dq, run.tau), strict=True)), suffix
    )
    read = Recording.load(file, joint_names=JOINTS)
    assert_same(read, run)
    (warning,) = read.warnings
    assert isinstance(warning, ColumnNamesWarning)
    assert "dq1 = " in str(warning)


def test_units_of_the_format_behind_names(run, tmp_path):
    names = ("t [s]", "q{j} [rad]", "dq{j} (rad/s)", "tau{j} [Nm]")
    signals = (run.t, run.q, run.dq, run.tau)
    assert_same(Recording.load(written(run, tmp_path, dict(zip(names, signals, strict=True)))), run)
    other = {"t [s]": run.t, "q{j} [deg]": run.q}
    with pytest.raises(RecordingError, match=r"--columns NAME=COLUMN"):
        Recording.load(written(run, tmp_path, other))


@pytest.mark.parametrize(
    "names",
    [
        ("time", "position_{j}", "pos_{j}"),  # two columns for one signal
        ("time", "position_{j}", "torque_{k}"),  # from 0 and from 1
        ("time", "{name}_x", "{name}_y"),
        ("when", "position_{j}", "effort_{j}"),
    ],
)
def test_ambiguous_names_are_refused_with_the_option(run, tmp_path, names):
    file = written(run, tmp_path, dict(zip(names, (run.t, run.q, run.tau), strict=True)))
    with pytest.raises(RecordingError, match=r"--columns NAME=COLUMN"):
        Recording.load(file)


def test_commanded_positions_and_other_signals(run, tmp_path):
    names = {"timestamp": run.t, "actual_q_{k}": run.q, "target_q_{k}": run.q + 0.1}
    names |= {"target_moment_{k}": run.tau, "tau_ext_{k}": run.tau}
    read = Recording.load(written(run, tmp_path, names))
    np.testing.assert_array_equal(read.command, run.q + 0.1)
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
def test_stated_columns(run, tmp_path, suffix, stated):
    more = {"alpha": run.q[:, 0], "beta": run.q[:, 1], "q1": run.q[:, 1], "w10": run.dq[:, 1]}
    more |= {"w9": run.dq[:, 0], "m 7x": run.tau[:, 0], "m 12x": run.tau[:, 1]}
    read = Recording.load(written(run, tmp_path, {"stamp": run.t}, suffix, **more), columns=stated)
    assert_same(read, run)
    (warning,) = read.warnings
    assert "q1 of the file" in str(warning)


def test_stated_columns_of_data_frames_and_whole_arrays(run, tmp_path):
    pd = pytest.importorskip("pandas")
    frame = pd.DataFrame({"s": run.t, "a": run.q[:, 0], "b": run.q[:, 1]})
    read = Recording.from_dataframe(frame, columns="t=s,q1=a,q2=b")
    np.testing.assert_array_equal(read.q, run.q)
    np.savez(tmp_path / "run.npz", s=run.t, angles=run.q, velocity=run.dq, effort=run.tau)
    read = Recording.load(tmp_path / "run.npz", columns="t=s,q=angles,dq=velocity,tau=effort")
    assert_same(read, run)


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
def test_what_cannot_be_assigned_is_refused(run, tmp_path, stated, message):
    run.save(tmp_path / "run.csv")
    with pytest.raises(RecordingError, match=message):
        Recording.load(tmp_path / "run.csv", columns=stated)


def test_an_npz_has_the_names_of_a_csv_or_whole_arrays(run, tmp_path):
    written(run, tmp_path, {"t": run.t, "q{j}": run.q, "dq{j}": run.dq, "tau{j}": run.tau}, "npz")
    read = Recording.load(tmp_path / "run.npz")
    assert_same(read, run)
    assert not read.warnings
    np.savez(tmp_path / "both.npz", t=run.t, q=run.q, dq1=run.dq[:, 0], dq2=run.dq[:, 1])
    np.testing.assert_array_equal(Recording.load(tmp_path / "both.npz").dq, run.dq)
