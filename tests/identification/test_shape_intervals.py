"""Intervals of shape parameters: coverage, ends that the data do not bound, and the file."""

import numpy as np
import pytest
from benchmarks.shape_intervals import HIDDEN, coverage, fits

import lieid_casadi as lieid
from lieid_casadi.errors import BoundWarning


@pytest.fixture(scope="module")
def fit():
    return next(iter(fits("stribeck", 1, noise=0.02)))


def test_the_interval_holds_the_truth_and_states_the_standard_deviation(fit, tmp_path):
    ((low, high),) = fit.shape_intervals
    assert low < HIDDEN["stribeck"][0] < high
    assert fit.std[-1] == pytest.approx((high - low) / 3.92, rel=1e-3)
    fit.save(tmp_path / "fit.json")
    loaded = lieid.Fit.load(tmp_path / "fit.json")
    np.testing.assert_array_equal(loaded.shape_intervals, fit.shape_intervals)
    np.testing.assert_array_equal(loaded.std, fit.std)


def test_an_end_that_the_data_do_not_bound_is_a_warning():
    """Without the effect its shape may be anything."""
    t = np.arange(0.0, 15.0, 0.01)[:, None]
    q, dq, ddq = np.sin([0.7, 1.9] * t), [0.7, 1.9] * np.cos([0.7, 1.9] * t), 0.0
    ddq = [-0.49, -3.61] * q
    model = lieid.Model(lieid.robots.two_link(), "coulomb,viscous,offset")
    links = model.robot.link_parameters
    tau = lieid.compile(model).inverse_dynamics(q, dq, ddq, links)
    tau = tau + np.sign(dq) + 0.05 * np.random.default_rng(0).normal(size=q.shape)
    recording = lieid.Recording.from_arrays(t[:, 0], q, dq, tau)
    fit = lieid.identify(model.with_effect("stribeck:1"), recording)
    (warning,) = [w for w in fit.warnings if isinstance(w, BoundWarning) and "v_s" in str(w)]
    assert "do not bound it" in str(warning) or "reached its bound" in str(warning)
    low, high = fit.shape_intervals[0]
    assert low == pytest.approx(1e-3) or high == pytest.approx(2.0)


@pytest.mark.slow
@pytest.mark.parametrize("effect", HIDDEN)
def test_intervals_cover_with_noise_correlated_over_a_third_of_a_second(effect):
    """The benchmark with 40 runs each is tests/benchmarks/shape_intervals.py."""
    held, _ = coverage(effect, 24, seed=500)
    assert held >= 0.87  # of 95 %; the standard error is 4 %
