"""Criteria and limits of the user's."""

import casadi as ca
import numpy as np
import pytest

import lieid_casadi as lieid
from lieid_casadi.errors import ExcitationError
from lieid_casadi.excitation import excite
from lieid_casadi.excitation.criteria import ExpressionCriterion, LogDet

ROBOT = lieid.robots.two_link()
MODEL = lieid.Model(ROBOT, effects="coulomb,viscous")
QUICK = {"duration": 6.0, "starts": 1, "limits": ()}


def volume(information):
    return -2.0 * ca.sum1(ca.log(ca.diag(ca.chol(information)))) / information.size1()


def test_a_criterion_of_the_users():
    """−log det as an expression: value, derivative, and the optimum of the built-in criterion."""
    rows = np.random.default_rng(3).normal(size=(30, 6))
    value, slope = ExpressionCriterion(volume, 6).evaluate(rows.T @ rows)
    expected, expected_slope = LogDet().evaluate(rows.T @ rows)
    assert np.isclose(value, expected)
    np.testing.assert_allclose(slope, expected_slope, rtol=1e-9)
    own, named = (excite(MODEL, criterion=c, **QUICK) for c in (volume, "logdet"))
    assert own.criterion == "volume"
    assert np.isclose(own.neg_log_det, named.neg_log_det, atol=0.5)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"limits": ["torque"]}, "limits: 'torque'; expected limits"),
        ({"criterion": lambda g: g}, "shape .*; expected a scalar"),
    ],
)
def test_bad_extensions(options, message):
    with pytest.raises(ExcitationError, match=message):
        excite(MODEL, **{**QUICK, **options})
