import sys
from dataclasses import replace

import numpy as np
import pytest
from recording.planar_arm import (
    COULOMB,
    PERIOD,
    VISCOUS,
    measured,
    motion,
    rigid_torque,
)

from lieid_casadi.errors import MissingDependency, RecordingError, ShortSegmentWarning
from lieid_casadi.recording import (
    Processing,
    Recording,
    choose_cutoff,
    detect_period,
    noise_dead_zone,
    period_noise,
    process,
)
from lieid_casadi.recording.filtering import lowpass
from lieid_casadi.recording.spectrum import motion_band, rounded_as


def one(recording, **options):
    (processed,) = process(recording, Processing(**options))
    return processed


@pytest.fixture(scope="module")
def processed():
    return one(measured(), cutoff=5.0)


def test_the_same_friction_comes_back_from_regular_and_irregular_stamps():
    for jitter in (0.0, 0.9):
        p = one(measured(jitter=jitter), cutoff=6.0)
        assert np.allclose(np.diff(p.t), p.t[1] - p.t[0])
        for j in range(2):
            columns = np.column_stack([np.sign(p.dq[:, j]) * p.moving[:, j], p.dq[:, j]])
            rest = p.filter((p.tau - rigid_torque(p.q, p.dq, p.ddq))[:, j])
            found = np.linalg.lstsq(p.filter(columns), rest, rcond=None)[0]
            np.testing.assert_allclose(found, [COULOMB[j], VISCOUS[j]], rtol=0.05)


def test_torque_and_columns_go_through_the_same_filter(processed):
    random = np.random.default_rng(0)
    columns = random.normal(size=(len(processed), 2, 4))
    beta = np.array([1.0, -2.0, 0.5, 3.0])
    filtered = processed.filter(columns)
    assert filtered.shape == (processed.filtered_time.size, 2, 4)
    np.testing.assert_allclose(filtered @ beta, processed.filter(columns @ beta), atol=1e-12)


def test_noise_above_the_new_nyquist_does_not_fold_back():
    recording = measured(duration=6, rate=5000, noise=0)
    p = one(recording, cutoff=10.0)
    hum = 5.0 * np.sin(2 * np.pi * (p.rate + 2.0) * recording.t)  # would look like 2 Hz
    noisy = Recording.from_arrays(
        recording.t, recording.q, recording.dq, recording.tau + hum[:, None]
    )
    q = one(noisy, cutoff=10.0)
    assert q.rate == p.rate
    np.testing.assert_allclose(q.filter(q.tau), p.filter(p.tau), atol=0.05)


def dwelling(noise):
    """One joint: moves 3 s, rests 3 s, moves 3 s …"""
    random = np.random.default_rng(0)
    t = np.arange(0, 12, 0.005)
    moving = (t // 3) % 2 == 0
    dq = np.where(moving, np.sin(np.pi * (t % 3) / 3) ** 2, 0.0)
    q = np.cumsum(dq) * 0.005
    return Recording.from_arrays(t, q[:, None], (dq + noise * random.normal(size=t.size))[:, None])


@pytest.mark.parametrize("noise", [0.0, 1e-3, 5e-3])
def test_rest_is_distinguished_from_motion(noise):
    p = one(dwelling(noise), cutoff=5.0)
    inside = (p.filtered_time % 3 > 0.4) & (p.filtered_time % 3 < 2.6)
    truth = (p.filtered_time // 3) % 2 == 0
    np.testing.assert_array_equal(p.filtered_moving[inside, 0], truth[inside])
    assert p.dead_zone[0] < 0.05


def test_a_reversal_is_no_rest(processed):
    assert processed.filtered_moving.all()
    assert processed.moving.all()
    assert (np.abs(processed.dq) < processed.dead_zone).any()


def test_segments_are_never_joined_across_a_gap():
    whole = measured(duration=12, noise=0)
    parts = whole.at((whole.t < 5) | (whole.t >= 7))
    first, second = process(parts, Processing(cutoff=5.0))
    assert first.t[-1] < 5.0
    assert second.t[0] >= 7.0
    alone = one(whole.cut(7, None), cutoff=5.0)
    np.testing.assert_array_equal(second.filter(second.tau), alone.filter(alone.tau))
    # a step between the segments does not leak into either
    np.testing.assert_array_equal(second.t, alone.t)


def test_short_segments_are_left_out_and_named():
    whole = measured(duration=12)
    parts = whole.at((whole.t < 0.8) | (whole.t >= 2))
    (p,) = process(parts, Processing(cutoff=5.0))
    (warning,) = p.warnings
    assert isinstance(warning, ShortSegmentWarning)
    assert "0 to 0.795 s is too short" in str(warning)


def test_segments_too_short_for_trimming():
    with pytest.raises(RecordingError, match=r"planar: 0 to 0\.995 s is too short: 0 s remain"):
        process(measured(duration=1.0), Processing(cutoff=5.0))
    assert one(measured(duration=1.0), cutoff=5.0, trim=0.1)


@pytest.mark.parametrize("velocities", [True, False])
def test_recordings_far_too_short_are_refused(velocities):
    whole = sines(1.0, rate=20_000.0, duration=0.004)
    with pytest.raises(RecordingError, match=r"too short: .* expected 0\.2 s or more"):
        process(whole if velocities else replace(whole, dq=None))


@pytest.mark.parametrize("velocities", [True, False])
def test_one_constant_speed_is_processed(velocities):
    t = np.arange(0.0, 20.0, 0.005)
    whole = Recording.from_arrays(t, 0.3 * t[:, None], np.full((t.size, 1), 0.3))
    (p,) = process(whole if velocities else replace(whole, dq=None))
    np.testing.assert_allclose(p.dq, 0.3, rtol=1e-9)


def test_a_cutoff_that_the_rate_cannot_show():
    with pytest.raises(RecordingError, match=r"cutoff 30 Hz, expected less than 22\.5 Hz"):
        process(measured(rate=50), Processing(cutoff=30.0))


@pytest.mark.parametrize(
    ("module", "name", "extra"),
    [("pyarrow", "run.parquet", "parquet"), ("rosbags.highlevel", "run.mcap", "ros")],
)
def test_formats_name_their_extra(monkeypatch, tmp_path, module, name, extra):
    (tmp_path / name).write_bytes(b"x")
    monkeypatch.setitem(sys.modules, module, None)
    with pytest.raises(MissingDependency, match=rf"lieid-casadi\[{extra}\]"):
        Recording.load(tmp_path / name)


def test_filtering_in_windows_is_filtering_the_whole():
    p = one(measured(duration=120.0), cutoff=5.0)
    x = np.cumsum(np.random.default_rng(0).normal(size=(len(p), 2)), axis=0) + 50.0
    assert len(p.windows) > 2
    whole = lowpass(x, p.rate, p.cutoff)[p.kept]
    np.testing.assert_allclose(p.filter(x), whole, atol=1e-10 * np.abs(x).max())


# -- Choice between the measured velocity and the derivative of the position --


COUNT = 2.0 * np.pi / 2**18


def at_rate(rate, *, noise, quantum=0.0, seed=0, duration=20.0):
    """Two joints; velocity with noise (per joint, rad/s), position in steps of a quantum."""
    random = np.random.default_rng(seed)
    t = np.arange(0.0, duration, 1.0 / rate)
    q, dq, _ = motion(t)
    if quantum:
        q = np.round(q / quantum) * quantum
    return Recording.from_arrays(t, q, dq + np.asarray(noise) * random.normal(size=q.shape), q)


def errors(recording, cutoff=5.0):
    """RMS error of dq and of the filtered ddq, per joint."""
    (p,) = process(recording, Processing(cutoff=cutoff))
    _, dq, ddq = motion(p.t)
    inner = slice(50, -50)
    slow = p.filter(p.ddq) - p.filter(ddq)
    return np.std((p.dq - dq)[inner], axis=0), np.std(slow[10:-10], axis=0)


def bare(recording):
    return Recording.from_arrays(recording.t, recording.q, tau=recording.tau)


@pytest.mark.parametrize("rate", [200, 1000])
def test_a_fine_encoder_replaces_a_noisy_velocity(rate):
    noisy = at_rate(rate, noise=2.8e-3, quantum=COUNT)
    for found, derived in zip(errors(noisy), errors(bare(noisy)), strict=True):
        np.testing.assert_allclose(found, derived, rtol=1e-9)
    clean_dq, clean_ddq = errors(at_rate(rate, noise=0.0, quantum=1e-2))  # uses dq
    assert np.all(errors(noisy)[1] < clean_ddq + 0.01)
    assert np.all(errors(noisy)[0] < clean_dq + 1e-3)


def test_a_coarse_encoder_does_not_replace_the_velocity():
    exact = at_rate(200, noise=0.0)
    coarse = at_rate(200, noise=2.8e-3, quantum=5e-3)
    measured_alone = errors(at_rate(200, noise=2.8e-3, quantum=1.0))
    for found, expected in zip(errors(coarse), measured_alone, strict=True):
        np.testing.assert_allclose(found, expected, rtol=1e-9)
    assert np.all(errors(coarse)[1] < 0.5 * errors(bare(coarse))[1])
    assert np.all(errors(exact)[1] < 0.01)


def test_acceleration_under_commands_is_not_too_small_at_a_low_rate():
    """Differences over two samples take 1 % from the acceleration of 1.4 Hz at 50 Hz."""
    t = np.arange(0.0, 20.0, 0.02)
    w = 2.0 * np.pi * 1.4
    q = np.column_stack([np.sin(w * t), np.cos(w * t)])
    (p,) = process(Recording.from_arrays(t, q, tau=q, command=q), Processing(cutoff=5.0))
    inner = slice(50, -50)
    np.testing.assert_allclose(p.ddq[inner], -(w**2) * p.q[inner], atol=1e-3 * w**2)


def test_acceleration_of_measured_velocities_is_not_too_small_at_a_low_rate():
    """Differences over two samples take 6 % from the acceleration of 10 Hz at 100 Hz."""
    t = np.arange(0.0, 20.0, 0.01)
    w = 2.0 * np.pi * 10.0
    q, dq = 0.01 * np.sin(w * t)[:, None], 0.01 * w * np.cos(w * t)[:, None]
    (p,) = process(Recording.from_arrays(t, q, dq, tau=q), Processing(cutoff=20.0))
    inner = slice(50, -50)
    np.testing.assert_allclose(p.ddq[inner], -(w**2) * q[inner], atol=1e-4 * w**2)


@pytest.mark.parametrize("rate", [100, 500])
@pytest.mark.parametrize("difference", [False, True])
def test_errors_of_accelerations_by_rounded_positions_have_the_size_of_the_true_ones(
    rate, difference
):
    t = np.arange(0.0, 30.0, 1.0 / rate)
    q = np.round(motion(t)[0] / 4e-4) * 4e-4
    dq = np.gradient(q, 1.0 / rate, axis=0) if difference else None
    (p,) = process(Recording.from_arrays(t, q, dq, tau=q), Processing(cutoff=8.0))
    errors = p.ddq - motion(p.t)[2], p.rounding_of_ddq
    true, found = (np.std(p.filter(error)[10:-10], axis=0) for error in errors)
    np.testing.assert_allclose(found, true, rtol=0.5)


def test_the_computer_s_rounding_is_no_quantum():
    counts = np.random.default_rng(0).integers(0, 400, size=(2000, 2))
    noise = 1e-16 * np.random.default_rng(1).normal(size=counts.shape)
    values = np.linspace(0.0, 0.5, 5000)[:, None] * [1.0, 1.0]
    steps = np.diff(rounded_as(np.deg2rad(counts * 0.1) + noise, values), axis=0)
    np.testing.assert_allclose(steps[steps > 0.0], np.deg2rad(0.1), rtol=1e-9)


def sines(frequency, rate=200.0, duration=20.0, noise=0.0):
    random = np.random.default_rng(0)
    t = np.arange(0, duration, 1 / rate)
    q = np.sin(2 * np.pi * frequency * t)
    dq = 2 * np.pi * frequency * np.cos(2 * np.pi * frequency * t)
    return Recording.from_arrays(t, q[:, None], (dq + noise * random.normal(size=t.size))[:, None])


@pytest.mark.parametrize("frequency", [0.3, 1.0, 3.0])
@pytest.mark.parametrize("noise", [0.0, 0.1])
def test_band_and_cutoff_follow_the_motion(frequency, noise):
    recording = sines(frequency, noise=noise)
    assert motion_band(recording) == pytest.approx(frequency, abs=0.25)
    assert choose_cutoff(recording) == pytest.approx(6 * frequency, rel=0.3, abs=1.5)


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("velocity", ["none", "exact", "late"])
def test_nothing_is_fitted_where_accelerations_are_noise(seed, velocity):
    """With 2¹⁸ counts their noise is half of that of the torque at 8 Hz, friction ends at 19 Hz."""
    random, inertia = np.random.default_rng(seed), 2.0
    t = np.arange(0.0, 40.0, 0.01)
    phase, f = random.uniform(0.0, 6.0, 3), 0.4 * np.pi * np.arange(1, 4)
    q, dq, ddq = (0.3 * f**k * np.sin(f * t[:, None] + phase + k * np.pi / 2) for k in range(3))
    torque = np.sign(dq.sum(axis=1)) + inertia * ddq.sum(axis=1) + 0.05 * random.normal(size=t.size)

    def cutoff(counts):
        step = 2.0 * np.pi / counts
        rounded = step * np.round(q.sum(axis=1, keepdims=True) / step)
        speed = (dq - 0.01 * ddq if velocity == "late" else dq).sum(axis=1, keepdims=True)
        dq_too = None if velocity == "none" else speed
        return choose_cutoff(Recording(t=t, q=rounded, dq=dq_too, tau=torque[:, None]))

    fine, coarse = cutoff(2.0**40), cutoff(2.0**18)
    if velocity == "exact":  # these have no noise; late ones are not used
        assert coarse == pytest.approx(fine, rel=0.1)
    else:
        assert coarse < 0.6 * fine
        assert cutoff(2.0**12) < 0.3 * fine


@pytest.mark.parametrize("rate", [200.0, 1000.0])
@pytest.mark.parametrize("seed", range(3))
def test_coarse_encoders_do_not_widen_the_band(seed, rate):
    """Rounding to 4096 counts has more than 1 % of the velocity's power."""
    random = np.random.default_rng(seed)
    t = np.arange(0.0, 20.0, 1.0 / rate)
    phase = random.uniform(0.0, 6.0, (4, 2))
    q = sum(0.15 * np.sin(2.0 * np.pi * 0.1 * (k + 1) * t[:, None] + phase[k]) for k in range(4))
    quantum = 2.0 * np.pi / 4096.0
    fine, coarse = (
        motion_band(Recording.from_arrays(t, x)) for x in (q, np.round(q / quantum) * quantum)
    )
    assert coarse == pytest.approx(fine, abs=0.3)


@pytest.mark.parametrize("period", [3.21, PERIOD, 9.87])
@pytest.mark.parametrize("jitter", [0.0, 0.8])
def test_period_is_found_to_a_millisecond(period, jitter):
    random = np.random.default_rng(0)
    t = np.arange(0, 33, 0.01) + 0.01 * jitter * random.uniform(-0.5, 0.5, 3300)
    q = motion(t, period)[0] + 1e-3 * random.normal(size=(3300, 2))
    assert detect_period(Recording.from_arrays(t, q)) == pytest.approx(period, abs=1e-3)


def test_no_period_where_there_is_none():
    assert detect_period(measured(duration=1.8 * PERIOD)) is None
    t = np.arange(0, 30, 0.01)
    chirp = np.column_stack([np.sin(0.1 * t**2), np.cos(t)])
    assert detect_period(Recording.from_arrays(t, chirp)) is None
    assert detect_period(Recording.from_arrays(t, np.zeros_like(chirp))) is None
    decaying = np.column_stack([np.exp(-t / 20) * np.sin(t), np.sin(t)])
    assert detect_period(Recording.from_arrays(t, decaying)) is None


def test_noise_from_period_to_period():
    recording = measured(duration=3 * PERIOD)
    noise = period_noise(recording)
    # linear interpolation between samples takes some of the white noise away
    assert np.all((noise > 0.7 * 0.3) & (noise < 1.05 * 0.3))
    filtered = period_noise(recording, cutoff=5.0)
    np.testing.assert_allclose(filtered, 0.3 * np.sqrt(5.0 / 100.0), rtol=0.25)
    assert period_noise(measured(duration=PERIOD)) is None
    assert period_noise(Recording.from_arrays(recording.t, recording.q)) is None


@pytest.mark.parametrize("noise", [2e-3, 2e-2])
def test_dead_zone_is_three_sigma_of_the_noise(noise):
    random = np.random.default_rng(0)
    t = np.arange(0, 20, 0.005)
    dq = motion(t)[1] * 0.1 + noise * random.normal(size=(4000, 2))
    np.testing.assert_allclose(noise_dead_zone(dq), 3 * noise, rtol=0.1)
    np.testing.assert_allclose(noise_dead_zone(dq, kept=0.25), 1.5 * noise, rtol=0.1)
