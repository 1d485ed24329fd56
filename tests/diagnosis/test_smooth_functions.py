"""Smooth functions of one signal: narrow ones, their code, and the choice among several."""

from types import SimpleNamespace

import casadi as ca
import numpy as np
import pytest

from lieid_casadi.diagnosis.options import DiagnosisOptions
from lieid_casadi.diagnosis.residual.shapes import SmoothShape
from lieid_casadi.diagnosis.residual.smooth_function_code import smooth_lists
from lieid_casadi.diagnosis.residual.smooth_selection import preferred
from lieid_casadi.diagnosis.screening.hysteresis import stops
from lieid_casadi.diagnosis.screening.smooth_functions import (
    basis_functions,
    depends_on_fit,
    signal_ranges,
    smooth_candidates,
)
from lieid_casadi.identification.uncertainty.noise_model import Runs

X = np.linspace(-1.0, 1.0, 1001)


def signals():
    x = X[:, None]
    values = dict.fromkeys(("q", "dq", "ddq", "load", "temperature", "time"), x)
    values |= {"sign": np.sign(x), "time": x + 1.0}
    return SimpleNamespace(segment=SimpleNamespace(n=1, temperature=None), values=values)


def basis(name):
    return basis_functions(signals(), signal_ranges([signals()]))[name]


def part_outside(columns, values):
    """Return the part of the variance of values (K, …) that columns and a constant leave."""
    columns = np.column_stack([np.ones(len(columns)), columns])
    rest = values - columns @ np.linalg.lstsq(columns, values, rcond=None)[0]
    return (rest**2).sum(axis=0) / ((values - values.mean(axis=0)) ** 2).sum(axis=0)


@pytest.mark.parametrize("centre", [-0.3, 0.1])
def test_a_narrow_bump_over_the_angle_is_smooth(centre):
    assert part_outside(basis("q1"), 1.0 / (1.0 + ((X - centre) / 0.1) ** 2)) < 0.02


@pytest.mark.parametrize("speed", [0.3, 0.5])
def test_friction_with_a_peak_at_one_speed_is_smooth(speed):
    peak = np.exp(-(((np.abs(X) - speed) / (0.25 * speed)) ** 2)) * np.sign(X)
    assert part_outside(basis("dq1"), peak) < 0.1


def test_a_step_where_the_load_changes_its_sign_is_smooth():
    assert part_outside(basis("load1"), np.tanh(X / 0.03)) < 0.02


def play(x, width):
    """Return a signal behind a play, sample by sample, from its first value on."""
    behind = x.copy()
    for k in range(1, len(x)):
        behind[k] = min(max(behind[k - 1], x[k] - width), x[k] + width)
    return behind


def test_stops_are_what_a_play_leaves():
    x = np.cumsum(np.random.default_rng(1).normal(size=(203, 2)), axis=0)
    widths = np.array([[0.5, 2.0], [1.0, 4.0]])
    found = stops(x, widths)
    for j, k in np.ndindex(2, 2):
        expected = x[:, j] - play(x[:, j], widths[j, k])
        assert found[:, j, k] == pytest.approx(expected, abs=1e-12)


@pytest.mark.parametrize("width", [0.15, 0.3])
def test_a_play_in_the_load_follows_the_stops_of_the_load_and_no_function_of_it(width):
    load = np.sin(12.0 * X) * (1.0 - 0.5 * X)
    along = signals()
    along.values["load"] = load[:, None]
    found = basis_functions(along, signal_ranges([along]))
    torque = load - play(load, width)
    assert part_outside(found["play1"], torque) < 0.03
    assert part_outside(found["load1"], torque) > 0.3


@pytest.mark.parametrize(
    ("name", "signal"), [("q1", "q"), ("dq1", "dq"), ("load1", "load"), ("ddq1", "ddq")]
)
def test_the_code_has_the_functions_of_the_basis(name, signal):
    low, high = signal_ranges([signals()])[signal][:, 0]
    shape = SmoothShape(0, (name,), ("rad",), (np.array([low, high]),), *[np.zeros(2)] * 3)
    ((code, count),) = smooth_lists(shape, {name: f"s.{signal}"})
    s = SimpleNamespace(**{signal: ca.SX.sym("x")})
    s.sign = ca.sign(getattr(s, signal))
    columns = ca.horzcat(*eval(code, {"ca": ca, "s": s}))
    assert columns.shape[1] == count
    inner = np.abs(X) < 0.97  # at the ends of the range the limits differ
    found = np.array(ca.Function("f", [getattr(s, signal)], [columns]).map(len(X))(X[None]))
    found = found.reshape(len(X), count)
    model = np.column_stack([np.sign(X), X])  # coulomb and viscous, which a model has
    both = np.column_stack([found[inner], model[inner]])
    assert part_outside(both, basis(name)[inner]).max() < 1e-6


def test_of_functions_that_explain_as_much_the_one_of_fewest_signals_is_chosen():
    options = DiagnosisOptions()
    pair, single = np.array([10.0, 12.0, 9.0, 11.0, 10.0]), np.array([9.0, 13.0, 8.0, 11.5, 9.5])
    names = [("q1", "q2"), ("q1",), ("q3",)]
    assert preferred(names, np.array([pair, single, 0.5 * pair]), options) == 1
    assert preferred(names, np.array([pair, single - 2.0, 0.5 * pair]), options) == 0


def test_a_function_of_time_is_chosen_only_if_it_is_clearly_the_best():
    gains = np.array([np.full(5, 10.0), [8.5, 8.6, 8.4, 8.5, 8.7]])
    assert preferred([("t",), ("q1",)], gains, DiagnosisOptions()) == 1
    assert preferred([("t",), ("q1",)], gains * [[1.0], [0.5]], DiagnosisOptions()) == 0


def test_functions_of_an_angle_or_a_speed_are_tried_with_fewer_terms_too():
    along = signals()
    along.segment.filter = lambda values: values
    runs = [Runs((np.arange(len(X)),), np.zeros(len(X)))]
    found = smooth_candidates([along], runs).owners
    sizes = {f.signals: [g.parameters for g in found if g.signals == f.signals] for f in found}
    assert sizes["q1",] == [9, 17]  # with a constant
    assert sizes["dq1",] == [7, 13]
    assert sizes["ddq1",] == [6]
    assert sizes["load1",] == [8]
    assert sizes["play1",] == [5]


def test_only_functions_of_the_load_are_evaluated_again_for_another_fit():
    filtered = []
    along = signals()
    along.segment.filter = lambda values: filtered.append(values.shape[1]) or values
    runs, known = [Runs((np.arange(len(X)),), np.zeros(len(X)))], {}
    first = smooth_candidates([along], runs, known=known)
    count = len(filtered)
    along.values["load"] = along.values["load"] ** 3
    again = smooth_candidates([along], runs, known=known)
    of_load = {names for f in first.owners if depends_on_fit(names := f.signals)}
    assert {"load1"} < {name for names in of_load for name in names}
    assert len(filtered) == count + len(of_load)
    for group, function in enumerate(first.owners):
        same = np.array_equal(first.stacked(group), again.stacked(group))
        assert same != depends_on_fit(function.signals)
