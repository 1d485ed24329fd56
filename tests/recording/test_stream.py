"""Recordings read part by part: the same signals as of the whole, and the same fit."""

import numpy as np
import pytest

import lieid_casadi as lieid
from lieid_casadi.errors import RecordingError
from lieid_casadi.recording import (
    Processing,
    Recording,
    RecordingStream,
    load_or_stream,
    process,
    recording_stream,
    stream,
)
from lieid_casadi.recording.processing import resampling

pq = pytest.importorskip("pyarrow.parquet")


def recording(samples=20_000, *, gaps=(), labels=None, dq=1e-3, seed=0):
    """Smooth motion of two joints at about 200 Hz, with a rest, jitter and noise (dq: rad/s)."""
    rng = np.random.default_rng(seed)
    t = np.arange(samples) * 0.005 + rng.uniform(-5e-4, 5e-4, samples)
    for gap in gaps:
        t[gap:] += 1.0
    phase = 2.0 * np.pi * np.outer(t, [0.21, 0.33])
    q, velocity = np.sin(phase), 2.0 * np.pi * np.array([0.21, 0.33]) * np.cos(phase)
    rest = slice(3 * samples // 20, 4 * samples // 20)
    q[rest], velocity[rest] = q[rest.start], 0.0
    tau = 3.0 * velocity + np.sign(velocity) + 0.1 * rng.normal(size=q.shape)
    noisy = None if dq is None else velocity + dq * rng.normal(size=q.shape)
    return Recording.from_arrays(t, q, noisy, tau, load=labels)


@pytest.fixture
def small_windows(monkeypatch):
    monkeypatch.setattr(resampling, "WINDOW", 3000)


@pytest.mark.parametrize("dq", [1e-2, 1e-6, None])
@pytest.mark.parametrize("cutoff", [1.0, 4.0, 20.0])
def test_a_long_segment_in_windows_is_that_of_the_whole(monkeypatch, dq, cutoff):
    long, decided, decide = recording(dq=dq), [], resampling.velocity_source
    with monkeypatch.context() as patch:
        patch.setattr(
            resampling, "velocity_source", lambda *a: decided.append(decide(*a)) or decided[0]
        )
        (whole,) = process(long, Processing(cutoff=cutoff))
    assert np.all(decided[0].derived == (dq != 1e-6))
    monkeypatch.setattr(resampling, "WINDOW", 3000)
    # the noise is estimated from samples; here from the whole
    monkeypatch.setattr(resampling, "_sampled_velocity", lambda *_: decided[0])
    (parts,) = process(long, Processing(cutoff=cutoff))
    assert parts.rate == whole.rate
    np.testing.assert_allclose(parts.t, whole.t, atol=1e-12)
    for name in ("q", "dq", "ddq", "tau"):
        one, other = getattr(parts, name), getattr(whole, name)
        np.testing.assert_allclose(one, other, atol=1e-10 * np.abs(other).max(), err_msg=name)
    np.testing.assert_array_equal(parts.moving, whole.moving)
    assert not parts.moving.all()


def test_noise_is_estimated_from_samples(monkeypatch):
    long = recording()
    (whole,) = process(long, Processing(cutoff=4.0))
    monkeypatch.setattr(resampling, "WINDOW", 3000)
    monkeypatch.setattr(resampling, "NOISE_ROWS", 1000)
    (parts,) = process(long, Processing(cutoff=4.0))
    np.testing.assert_allclose(parts.dead_zone, whole.dead_zone, rtol=0.1)


@pytest.mark.parametrize("group", [700, 1 << 20])
def test_a_file_in_parts_gives_what_the_loaded_one_gives(tmp_path, small_windows, group):
    long = recording(gaps=[9000], labels=["a"] * 14_000 + ["b"] * 6000)
    path = tmp_path / "long.parquet"
    long.save(path)
    pq.write_table(pq.read_table(path), path, row_group_size=group)
    loaded, streamed = Recording.load(path), stream(path)
    assert (len(streamed), streamed.n, streamed.name) == (20_000, 2, "long.parquet")
    assert streamed.source_hash == loaded.source_hash
    options = Processing(cutoff=4.0)
    expected, found = process(loaded, options), process(streamed, options)
    assert [len(s) for s in found] == [len(s) for s in expected]
    assert [s.payload_label for s in found] == ["a", "a", "b"]
    for one, other in zip(found, expected, strict=True):
        for name in ("t", "q", "dq", "ddq", "tau", "moving"):
            np.testing.assert_array_equal(getattr(one, name), getattr(other, name))


def test_parts_in_any_order(tmp_path):
    long = recording(5000)
    long.save(tmp_path / "r.parquet")
    streamed = stream(tmp_path / "r.parquet")
    for first, last in [(0, 10), (4000, 5000), (2, 3000), (2500, 2600), (0, 5000)]:
        part = streamed.rows(first, last)
        np.testing.assert_array_equal(part.q, long.q[first:last])
        np.testing.assert_array_equal(part.t, long.t[first:last])


def test_a_time_range_of_a_file(tmp_path):
    long = recording(5000)
    long.save(tmp_path / "r.parquet")
    path = f"{tmp_path / 'r.parquet'}@5:12"
    expected = Recording.load(path)
    streamed = stream(path)
    np.testing.assert_array_equal(streamed.t, expected.t)
    np.testing.assert_array_equal(streamed.rows(0, len(streamed)).tau, expected.tau)


def test_other_formats_are_loaded_one_at_a_time(tmp_path):
    files = [tmp_path / name for name in ("a.csv", "b.npz")]
    for seed, file in enumerate(files):
        recording(2000, seed=seed).save(file)
    options = Processing(cutoff=4.0)
    found = process([stream(file) for file in files], options)
    expected = process([Recording.load(file) for file in files], options)
    for one, other in zip(found, expected, strict=True):
        np.testing.assert_array_equal(one.tau, other.tau)


def test_a_stream_identifies_as_the_recording_does(tmp_path, small_windows):
    model = lieid.Model(lieid.robots.two_link(), "coulomb,viscous,offset")
    recording(gaps=[9000]).save(tmp_path / "r.parquet")
    whole = lieid.identify(model, Recording.load(tmp_path / "r.parquet"))
    parts = lieid.identify(model, stream(tmp_path / "r.parquet"))
    assert parts.processing == whole.processing
    np.testing.assert_allclose(parts.values, whole.values, rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(parts.std, whole.std, rtol=1e-9)
    assert parts.provenance == whole.provenance


def test_nan_in_a_late_part_is_located(tmp_path):
    long = recording(5000)
    path = tmp_path / "r.parquet"
    long.save(path)
    table = pq.read_table(path).to_pandas()
    table.loc[4321, "q2"] = np.nan
    table.to_parquet(path)
    with pytest.raises(RecordingError, match=r"rows 1 to 5000.*row 4322, column q2: found nan"):
        process(stream(path), Processing(cutoff=4.0))


def test_averaged_periods_need_the_recording_in_memory(tmp_path):
    recording(2000).save(tmp_path / "r.parquet")
    with pytest.raises(RecordingError, match="in memory"):
        process(stream(tmp_path / "r.parquet"), Processing(cutoff=4.0, average_periods=True))


def test_missing_and_damaged_files(tmp_path):
    with pytest.raises(RecordingError, match="no such file"):
        stream(tmp_path / "none.parquet")
    (tmp_path / "text.parquet").write_text("t,q1\n")
    with pytest.raises(RecordingError, match="not a Parquet file"):
        stream(tmp_path / "text.parquet")


def test_large_files_are_streamed(tmp_path, monkeypatch):
    path = tmp_path / "r.parquet"
    recording(2000).save(path)
    assert isinstance(load_or_stream(path), Recording)
    monkeypatch.setattr(recording_stream, "memory_bytes", lambda: 8 * 2000 * 6 * 8)
    assert isinstance(load_or_stream(path, n=2), RecordingStream)
    assert isinstance(load_or_stream(f"{path}@1:3"), RecordingStream)
