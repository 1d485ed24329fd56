"""Quadratic programs: optimality conditions, and programs without a solution."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from lieid_casadi.excitation.solvers import quadratic_program


@settings(max_examples=60, deadline=None)
@given(st.integers(0, 10_000), st.integers(1, 20), st.integers(0, 40))
def test_solutions_meet_the_optimality_conditions(seed, size, rows):
    rng = np.random.default_rng(seed)
    half = rng.normal(size=(size, size))
    hessian = half @ half.T + 0.1 * np.eye(size)
    gradient, matrix = rng.normal(size=size), rng.normal(size=(rows, size))
    limit = rng.uniform(0.0, 1.0, rows)
    solution = quadratic_program.solve(hessian, gradient, matrix, limit)
    assert solution is not None
    d, multipliers = solution.step, solution.multipliers
    assert np.all(matrix @ d <= limit + 1e-8)
    assert np.all(multipliers >= 0.0)
    np.testing.assert_allclose(hessian @ d + gradient + multipliers @ matrix, 0.0, atol=1e-7)
    np.testing.assert_allclose(multipliers * (limit - matrix @ d), 0.0, atol=1e-7)


def test_program_with_known_solution():
    solution = quadratic_program.solve(
        np.eye(2), np.array([-3.0, 1.0]), np.eye(2), np.array([1.0, 5.0])
    )
    np.testing.assert_allclose(solution.step, [1.0, -1.0], atol=1e-12)
    np.testing.assert_allclose(solution.multipliers, [2.0, 0.0], atol=1e-12)


def test_programs_without_solution():
    matrix = np.array([[1.0], [-1.0]])
    assert quadratic_program.solve(np.eye(1), np.zeros(1), matrix, np.array([-1.0, -1.0])) is None
    assert quadratic_program.solve(-np.eye(1), np.zeros(1), matrix, np.ones(2)) is None
