"""Folds of the cross-validation: directions of the parameters that the other rows hardly excite."""

import numpy as np
import pytest

from lieid_casadi.compiled.triangular_factors import Triangle
from lieid_casadi.identification.regression.cross_validation import with_whole_fit
from lieid_casadi.identification.regression.least_squares import Factor, solve

WHOLE = np.array([1.0, 2.0])  # values of the fit of all rows


def factor(matrix, torque):
    triangle = Triangle(3)
    triangle.add(np.asarray(matrix, dtype=float), np.asarray(torque, dtype=float))
    return Factor(triangle.r, len(matrix))


@pytest.mark.parametrize(("excited", "second"), [(1e-3, 2.0), (0.5, 7.0)])
def test_a_fold_keeps_what_its_rows_do_not_determine(excited, second):
    """The other rows alone give (3, 7); they hardly depend on the second parameter, or they do."""
    rest = factor([[1.0, 0.0], [0.0, excited]], [3.0, 7.0 * excited])
    held = factor([[0.0, 1.0]], [2.0])
    np.testing.assert_allclose(solve(rest).values, [3.0, 7.0])
    found = solve(with_whole_fit(rest, held, WHOLE)).values
    np.testing.assert_allclose(found, [3.0, second], atol=0.01)
