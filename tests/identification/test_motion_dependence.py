"""Dependence of the residual on the motion, and its place in fit files."""

import numpy as np

from lieid_casadi.identification.uncertainty.noise_model import motion_ratio_of

SURE = np.ones(900)


def test_stationary_noise_has_ratio_one():
    random = np.random.default_rng(0)
    ratios = [
        motion_ratio_of(random.standard_normal(900), SURE, np.arange(900), 1.0, 30)
        for _ in range(200)
    ]
    assert np.mean(np.array(ratios) > 1.0) < 0.12  # the test's level is 5 %
    assert np.max(ratios) < 1.4


def test_rows_with_uncertain_friction_are_no_dependence_on_the_motion():
    random = np.random.default_rng(3)
    uncertain = np.arange(900) % 150 < 12
    residual = random.standard_normal(900) * np.where(uncertain, 10.0, 1.0)
    weights = np.where(uncertain, 0.3, 1.0)
    assert motion_ratio_of(residual, weights, np.arange(900), 1.0, 30) == 1.0
    assert motion_ratio_of(weights * residual, SURE, np.arange(900), 1.0, 30) > 1.2
