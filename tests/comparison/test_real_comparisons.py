"""Comparisons on recordings of a UR10e, against reference results of ordinary least squares."""

import numpy as np
import pytest
from real_arms import UR10E, needs, ur10e_fit, ur10e_run

import lieid_casadi as lieid
from lieid_casadi.comparison.comparison import verdict
from lieid_casadi.comparison.plots import binned_mean

pytestmark = [pytest.mark.real, needs(UR10E / "ur10e.urdf")]

PLAIN = "coulomb,viscous,offset,armature"


def test_excitation_is_as_good_as_the_reference():
    plain = ur10e_fit(PLAIN)
    comparison = lieid.compare(plain, ur10e_run("excitation_14_harmonics"))
    reference = np.array([2.49, 3.74, 1.42, 0.34, 0.37, 0.31])
    reference_raw = np.array([3.40, 4.45, 1.82, 0.50, 0.58, 0.47])
    assert np.all(comparison.rms < 1.05 * reference)
    assert np.all(comparison.rms_raw < 1.05 * reference_raw)
    np.testing.assert_allclose(comparison.rms, reference, rtol=0.05)
    np.testing.assert_allclose(comparison.torque_rms, [34.2, 101.9, 35.6, 4.9, 4.4, 4.1], rtol=0.02)
    assert np.all(comparison.correlation > 0.99)
    assert np.all(comparison.noise_floor < comparison.rms)


def test_dwells_of_the_wrist_are_reported():
    plain = ur10e_fit(PLAIN)
    comparison = lieid.compare(plain, ur10e_run("point_to_point"))
    reference = np.array([2.58, 3.21, 1.38, 0.23, 1.09, 1.42])
    assert np.all(comparison.rms < 1.07 * reference)
    assert np.flatnonzero(comparison.rest_dominates).tolist() == [4, 5]
    assert "On joints 5, 6 the error at rest" in verdict(comparison)
    assert np.all(comparison.rms_moving[4:] < 0.4)
    assert np.all(comparison.rms_at_rest[4:] > 1.5)


def direction_difference(comparison, joint):
    """Difference of the mean errors of both directions at small and at large |load|, N·m."""
    (series,) = comparison.series
    sign, load = series.sign[:, joint], np.abs(series.load[:, joint])
    edges = np.percentile(load, [0.0, 25.0, 75.0, 100.0])
    forward, backward = (
        binned_mean(load[sign == s], series.error[sign == s, joint], edges)[1] for s in (1.0, -1.0)
    )
    apart = forward - backward
    return apart[0], apart[-1]


def test_error_depends_on_load_until_friction_grows_with_load():
    plain = ur10e_fit(PLAIN)
    better = ur10e_fit(f"{PLAIN},load_friction:2+3")
    test = ur10e_run("excitation_14_harmonics")
    before, after = lieid.compare(plain, test), lieid.compare(better, test)
    for joint in (1, 2):
        small, large = direction_difference(before, joint)
        assert small < 0.0 < large
        assert large - small > 1.5 * before.rms[joint]
        closed_small, closed_large = direction_difference(after, joint)
        assert abs(closed_large - closed_small) < 0.3 * (large - small)
        assert after.rms[joint] < 0.75 * before.rms[joint]
