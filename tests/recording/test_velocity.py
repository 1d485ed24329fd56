"""Choice between the measured velocity and the derivative of the position."""

import numpy as np
import pytest
from recording.planar_arm import measured, motion

from lieid_casadi.recording import Processing, Recording, process

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


def test_joint_by_joint():
    found, _ = errors(at_rate(200, noise=[0.0, 5e-3]))
    kept, _ = errors(at_rate(200, noise=0.0, quantum=1.0))
    assert found[0] == pytest.approx(kept[0], rel=1e-9)
    assert found[1] < 1e-3


def test_the_measured_velocity_is_kept_where_samples_are_far_apart():
    """A central difference over a long sample misses part of the motion."""
    slow = at_rate(12, noise=1e-3)
    kept = at_rate(12, noise=1e-3, quantum=1.0)
    for found, expected in zip(errors(slow, 2.0), errors(kept, 2.0), strict=True):
        np.testing.assert_allclose(found, expected, rtol=1e-9)


def test_dead_zone_of_a_derivative_is_that_of_the_filtered_one():
    """A count per sample is no noise: the filter lets little of it through."""
    fine = bare(at_rate(1000, noise=0.0, quantum=COUNT))
    (p,) = process(fine, Processing(cutoff=5.0))
    top = np.percentile(np.abs(p.dq), 99, axis=0)
    np.testing.assert_allclose(p.dead_zone, 3e-3 * top, rtol=0.3)
    # all but one in a hundred samples of a joint at rest are in it
    held = Recording.from_arrays(fine.t, np.where(fine.t[:, None] > 10.0, fine.q[10_000], fine.q))
    (p,) = process(held, Processing(cutoff=5.0))
    assert np.mean(p.moving[p.t > 10.5]) < 0.01


def test_a_noisy_measured_velocity_still_determines_the_dead_zone():
    arm = measured(noise=0.2)
    (p,) = process(arm, Processing(cutoff=5.0))
    assert np.all(p.dead_zone > 0)
