"""Variable projection against an optimization over all parameters."""

import numpy as np
import pytest
from scipy.optimize import approx_fprime, least_squares

import lieid_casadi as lieid
from lieid_casadi.identification.regression.design_matrix import Design
from lieid_casadi.identification.regression.variable_projection import (
    SeparableProblem,
    ShapeRange,
    minimize_shapes,
)
from lieid_casadi.recording import Processing, process

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


def test_columns_that_depend_on_shapes_or_load_are_those_of_the_last_shapes_and_load():
    robot, t = lieid.robots.two_link(), np.arange(0.0, 6.0, 0.01)
    q = np.column_stack([np.sin(t), 0.5 * np.cos(2.0 * t)])
    segments = process(lieid.Recording.from_arrays(t, q, tau=np.cos(q)), Processing(cutoff=10.0))
    compiled = lieid.compile(lieid.Model(robot, "load_friction,stribeck"))
    design = Design(compiled, segments)
    links = robot.link_parameters
    inputs = [(np.array(v), x * links) for v in ([0.1, 0.1], [0.2, 0.1]) for x in (1.0, 2.0)]
    for shapes, load in (*inputs, inputs[0], inputs[0]):
        fresh = Design(compiled, segments).varying_rows(shapes, load)
        for found, expected in zip(design.varying_rows(shapes, load), fresh, strict=True):
            np.testing.assert_array_equal(found, expected)
