"""Variable projection against an optimization over all parameters."""

import numpy as np
import pytest
from scipy.optimize import approx_fprime, least_squares

from lieid_casadi.identification.regression.variable_projection import (
    SeparableProblem,
    ShapeRange,
    minimize_shapes,
)

X = np.linspace(0.0, 4.0, 120)
RANGES = ShapeRange(np.array([0.05, 0.0]), np.array([5.0, 6.0]))  # logarithmic, linear


def columns(shapes):
    decay, frequency = shapes
    return np.column_stack([np.exp(-decay * X), np.sin(frequency * X)])


def problem(**options):
    random = np.random.default_rng(0)
    target = columns([0.8, 2.3]) @ [2.0, -0.5] + 0.3 * X + 0.02 * random.standard_normal(len(X))
    fixed, _ = np.linalg.qr(X[:, None])
    return SeparableProblem(
        columns=columns, target=target, ranges=RANGES, **{"fixed": fixed, **options}
    )


def test_the_minimum_is_that_over_all_parameters():
    separable = problem()
    shapes = minimize_shapes(separable, np.array([1.5, 2.0]), xtol=1e-10, ftol=1e-12)

    def residual(parameters):
        return separable.target - columns(parameters[:2]) @ parameters[2:4] - parameters[4] * X

    joint = least_squares(residual, [0.8, 2.3, 2.0, -0.5, 0.3], xtol=1e-12)
    np.testing.assert_allclose(shapes, joint.x[:2], rtol=1e-4)
    np.testing.assert_allclose(separable.solve(shapes).coefficients, joint.x[2:4], rtol=1e-4)
    assert np.sum(separable.solve(shapes).residual ** 2) == pytest.approx(2.0 * joint.cost)


@pytest.mark.parametrize("upper", [np.inf, 1.5])
def test_the_gradient_of_the_cost_follows_from_the_jacobian(upper):
    """2·Jᵀr is exact at any shapes, also with a coefficient at its bound."""
    separable = problem(bounds=(np.full(2, -np.inf), np.full(2, upper)))
    shapes = np.array([1.1, 2.0])
    solution = separable.solve(shapes)
    assert np.isclose(solution.coefficients, upper).any() == np.isfinite(upper)
    gradient = 2.0 * separable.jacobian(shapes, solution).T @ solution.residual
    expected = approx_fprime(shapes, lambda s: np.sum(separable.solve(s).residual ** 2), 1e-6)
    np.testing.assert_allclose(gradient, expected, rtol=2e-3)
