"""Accuracy of the C runtime's own sine, cosine and exponential."""

import casadi as ca
import numpy as np
import pytest

import lieid_casadi as lieid
from lieid_casadi.compiled import compile
from lieid_casadi.compiled.batch_evaluation import CompiledEvaluation
from lieid_casadi.compiled.compiler import available_targets
from lieid_casadi.effects import Coefficient, Effect

pytestmark = pytest.mark.usefixtures("compiler")

LANES = [target.lanes for target in available_targets()]


class Functions(Effect):
    name, formula, signals = "functions", "sin q, cos q, exp q", ("q",)
    coefficients = (Coefficient("s", "1"), Coefficient("c", "1"), Coefficient("e", "1"))

    def columns(self, s, shape):
        return [ca.sin(s.q), ca.cos(s.q), ca.exp(s.q)]


def evaluate(x, lanes):
    """sin x, cos x, exp x by the C runtime."""
    arm = compile(lieid.Model(lieid.robots.two_link(), effects=[Functions()]), lanes=lanes)
    q = np.column_stack([x, x])
    values = arm.effect_columns(q, q, q)[:, 0, :3]
    assert isinstance(arm._evaluation("effect_columns"), CompiledEvaluation)
    return values.T


def error(got, exact):
    """Error in units of the last place of the exact result."""
    return np.abs((got - exact) / np.spacing(np.abs(exact).astype(float))).max()


@pytest.mark.skipif(np.finfo(np.longdouble).nmant < 60, reason="no wider numbers to compare with")
@pytest.mark.parametrize("lanes", LANES)
@pytest.mark.parametrize("size", [1e-9, 1e-3, 1.0, 10.0, 1e3, 3e4, 1e6, 1e15, 1e300])
def test_sine_and_cosine_are_exact_to_one_unit(size, lanes):
    x = size * np.random.default_rng(0).normal(size=20_000)
    sine, cosine, _ = evaluate(x, lanes)
    wide = x.astype(np.longdouble)
    assert error(sine, np.sin(wide)) < 1.0
    assert error(cosine, np.cos(wide)) < 1.0


@pytest.mark.skipif(np.finfo(np.longdouble).nmant < 60, reason="no wider numbers to compare with")
@pytest.mark.parametrize("lanes", LANES)
def test_sine_and_cosine_near_their_zeros(lanes):
    x = np.arange(-3000, 3000) * (np.pi / 2)
    large = np.arange(50_000, 70_000) * (np.pi / 2)
    x = np.concatenate([x, np.nextafter(x, np.inf), x + 1e-7, large])
    sine, cosine, _ = evaluate(x, lanes)
    wide = x.astype(np.longdouble)
    assert error(sine, np.sin(wide)) < 1.5
    assert error(cosine, np.cos(wide)) < 1.5


@pytest.mark.skipif(np.finfo(np.longdouble).nmant < 60, reason="no wider numbers to compare with")
@pytest.mark.parametrize("lanes", LANES)
def test_exponential_is_exact_to_one_unit(lanes):
    x = np.concatenate([np.linspace(-708, 709.7, 40_001), np.linspace(-1e-8, 1e-8, 101)])
    assert error(evaluate(x, lanes)[2], np.exp(x.astype(np.longdouble))) < 1.0


@pytest.mark.parametrize("lanes", LANES)
def test_ends_of_the_range(lanes):
    x = np.array([np.inf, -np.inf, np.nan, 0.0, -0.0, 710.0, 1e308, -745.0, -746.0, -1e308])
    with np.errstate(all="ignore"):
        expected = np.sin(x), np.cos(x), np.exp(x)
    for got, exact in zip(evaluate(x, lanes), expected, strict=True):
        np.testing.assert_allclose(got, exact, rtol=1e-15, atol=1e-323)
