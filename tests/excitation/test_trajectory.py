"""Trajectories: Eq. 19 as printed, end conditions (Eq. 20), derivatives."""

import numpy as np
import pytest

from lieid_casadi.errors import ExcitationError
from lieid_casadi.excitation.trajectory import (
    Fourier,
    Parametrization,
    Trajectory,
    null_space,
)

UNITS = np.array([[2.0, 2.0, 5.0], [1.0, 3.0, 9.0]])


@pytest.fixture(name="p")
def parametrization():
    return Parametrization(Fourier(4, 8.0), np.array([0.3, -0.7]), UNITS)


def test_fourier_series_as_printed():
    rng = np.random.default_rng(0)
    q0, a, b = rng.normal(), rng.normal(size=3), rng.normal(size=3)
    basis = Fourier(3, 20.0)
    t, w = np.linspace(0.0, 20.0, 50), 2.0 * np.pi * 0.05
    expected = q0 + sum(
        a[k - 1] / (k * w) * np.sin(k * w * t) - b[k - 1] / (k * w) * np.cos(k * w * t)
        for k in (1, 2, 3)
    )
    motion = Trajectory(basis, np.concatenate([[q0], a, b])[None]).at(t)
    np.testing.assert_allclose(motion.q[:, 0], expected, atol=1e-12)


def test_rounding_does_not_rotate_the_free_variables():
    """The singular vectors of a null space do rotate: other processors began elsewhere."""
    ends = Fourier(4, 8.0).evaluate(np.array([0.0, 8.0]))
    rows = np.vstack([ends[k] * 8.0**k for k in (0, 1, 2)])
    noise = 1e-14 * np.abs(rows).max() * np.random.default_rng(0).normal(size=rows.shape)
    directions = null_space(rows)
    np.testing.assert_allclose(null_space(rows + noise), directions, atol=1e-9)
    np.testing.assert_allclose(rows @ directions, 0.0, atol=1e-10 * np.abs(rows).max())
    np.testing.assert_allclose(directions.T @ directions, np.eye(directions.shape[1]), atol=1e-12)
    assert directions.shape[1] == rows.shape[1] - np.linalg.matrix_rank(rows)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"duration": 0.0}, "duration: 0 s"),
        ({"duration": float("nan")}, "duration: nan s"),
        ({"harmonics": 1}, "harmonics: 1; expected 2 to 100"),
    ],
)
def test_bad_series(options, message):
    with pytest.raises(ExcitationError, match=message):
        Fourier(**options)
