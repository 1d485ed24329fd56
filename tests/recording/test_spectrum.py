import numpy as np
import pytest
from recording.planar_arm import PERIOD, measured, motion

from lieid_casadi.recording import (
    Recording,
    choose_cutoff,
    detect_period,
    noise_dead_zone,
    period_noise,
)
from lieid_casadi.recording.spectrum import motion_band


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
def test_coarse_encoders_do_not_widen_the_band(seed):
    """Rounding to 4096 counts has more than 1 % of the velocity's power."""
    random = np.random.default_rng(seed)
    t = np.arange(0.0, 20.0, 0.005)
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
