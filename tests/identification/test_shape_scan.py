"""Shape parameters follow from the data, not from an order or a start; their intervals."""

from dataclasses import replace

import numpy as np
import pytest
from benchmarks.shape_intervals import HIDDEN, coverage, fits
from plant.recordings import recorded as measured
from scipy.optimize import approx_fprime, least_squares

import lieid_casadi as lieid
from lieid_casadi import plant
from lieid_casadi.errors import BoundWarning
from lieid_casadi.identification.regression.design_matrix import Design
from lieid_casadi.identification.regression.least_squares import combine, solve
from lieid_casadi.identification.regression.resolved_shapes import resolved_range
from lieid_casadi.identification.regression.shape_refinement import RefinementProblem
from lieid_casadi.identification.regression.variable_projection import (
    SeparableProblem,
    ShapeRange,
    minimize_shapes,
)
from lieid_casadi.recording import Processing, process

ROBOT = lieid.robots.two_link()
OPTIONS = Processing(cutoff=8.0)


def recorded(hidden):
    """An arm with friction, whose joint 2 has a further torque; 100 Hz, 16 s."""
    friction = plant.JointFriction(np.array([1.2, 0.5]), np.array([0.6, 0.3]), np.zeros(2))
    arm = plant.Arm(ROBOT, ROBOT.link_parameters, friction)
    sensors = plant.Sensors(rate=100.0, torque_noise=0.02)
    run = measured(arm, 0, seconds=16.0, step=0.01, sensors=sensors)
    tau = run.tau.copy()
    tau[:, 1] += hidden(run.q[:, 1], run.dq[:, 1])
    return replace(run, tau=tau)


def ripple(q, dq):
    """A strong ripple of low order and a weak one of high order, as of a harmonic drive."""
    slow = np.exp(-((dq / 0.3) ** 2))
    return 0.2 * np.sin(2.3 * q) + slow * 0.2 * np.sin(202.0 * q) + 0.3 * np.sign(dq) * slow


MODELS = {
    "ripple": "coulomb,viscous,offset,torque_ripple:2,stribeck:2",
    "hysteresis": "viscous,offset,presliding:1+2,stribeck:2,position_friction:2",
    "load": "coulomb,viscous,load_friction/stribeck:2,torque_ripple:2,stribeck:1+2",
}
CASES = ["ripple", *(pytest.param(x, marks=pytest.mark.slow) for x in ("hysteresis", "load"))]


@pytest.mark.parametrize("name", CASES)
def test_order_does_not_change_the_fit(name):
    run = recorded(ripple)
    effects = [
        p.label for p in lieid.Model(ROBOT, MODELS[name]).placements
    ]  # one by one, so that any order is possible
    first = lieid.identify(lieid.Model(ROBOT, effects), run, processing=OPTIONS)
    found = dict(zip([s.label for s in first.model.shapes], first.shapes, strict=True))
    for order in (effects[::-1], effects[2:] + effects[:2]):
        model = lieid.Model(ROBOT, order)
        fit = lieid.identify(model, run, processing=OPTIONS)
        expected = [found[s.label] for s in model.shapes]
        np.testing.assert_allclose(fit.shapes, expected, rtol=1e-3)
        np.testing.assert_allclose(fit.rms_train, first.rms_train, rtol=1e-6)


def test_the_order_of_a_ripple_is_found_among_all():
    """Between 1.9 and 400, beside effects whose shapes are searched as well."""

    def hidden(q, dq):
        return 0.3 * np.exp(-((dq / 0.2) ** 2)) * np.sign(dq) + 0.15 * np.cos(202.0 * q + 0.5)

    run = recorded(hidden)
    model = lieid.Model(ROBOT, "coulomb,viscous,offset,stribeck:1+2,torque_ripple:1+2")
    fit = lieid.identify(model, run, processing=OPTIONS)
    found = dict(zip([s.label for s in model.shapes], fit.shapes, strict=True))
    assert found["torque_ripple.k:2"] == pytest.approx(202.0, abs=0.1)
    assert found["stribeck.v_s:2"] == pytest.approx(0.2, rel=0.2)


def test_torque_where_the_sign_of_the_velocity_is_uncertain_is_no_stribeck_friction():
    """However large: it lasts for less of the velocity than its noise is."""

    def hidden(q, dq):
        at_reversals = 6.0 * np.exp(-((dq / 0.004) ** 2))
        return (0.3 * np.exp(-((dq / 0.2) ** 2)) + at_reversals) * np.sign(dq)

    run = recorded(hidden)
    noise = np.random.default_rng(1).normal(0.0, 0.002, run.dq.shape)
    run = replace(run, dq=run.dq + noise)
    model = lieid.Model(ROBOT, "coulomb,viscous,offset,stribeck:2")
    fit = lieid.identify(model, run, processing=OPTIONS)
    assert fit.shapes[0] == pytest.approx(0.2, rel=0.2)


@pytest.mark.parametrize("name", CASES)
def test_no_value_of_a_shape_lowers_the_error(name):
    """Each shape in turn over a grid of this test, the others and their load held."""
    run = recorded(ripple)
    model = lieid.Model(ROBOT, MODELS[name])
    fit = lieid.identify(model, run, processing=OPTIONS)
    cost = np.sum(np.log(fit.noise))
    ranges = resolved_range(Design(lieid.compile(model), process(run, OPTIONS)))
    for k, (lower, upper) in enumerate(zip(ranges.lower, ranges.upper, strict=True)):
        for place in (0.05, 0.5, 0.95):
            values = fit.shapes.copy()
            low = max(lower, 1e-9)
            values[k] = low * (upper / low) ** place
            held = lieid.identify(model, run, processing=OPTIONS, held_shapes=values)
            assert np.sum(np.log(held.noise)) > cost - 1e-3


X = np.linspace(0.0, 4.0, 120)
RANGES = ShapeRange(np.array([0.05, 0.0]), np.array([5.0, 6.0]))  # logarithmic, linear


def columns(shapes):
    decay, frequency = shapes
    return np.column_stack([np.exp(-decay * X), np.sin(frequency * X), X])


def problem(**options):
    random = np.random.default_rng(0)
    target = columns([0.8, 2.3]) @ [2.0, -0.5, 0.3] + 0.02 * random.standard_normal(len(X))
    return SeparableProblem(columns=columns, target=target, ranges=RANGES, **options)


def test_the_minimum_is_that_over_all_parameters():
    separable = problem()
    shapes = minimize_shapes(separable, np.array([1.5, 2.0]), xtol=1e-10, ftol=1e-12)

    def residual(parameters):
        return separable.target - columns(parameters[:2]) @ parameters[2:]

    joint = least_squares(residual, [0.8, 2.3, 2.0, -0.5, 0.3], xtol=1e-12)
    np.testing.assert_allclose(shapes, joint.x[:2], rtol=1e-4)
    np.testing.assert_allclose(separable.solve(shapes).coefficients, joint.x[2:], rtol=1e-4)
    assert np.sum(separable.solve(shapes).residual ** 2) == pytest.approx(2.0 * joint.cost)


@pytest.mark.parametrize("upper", [np.inf, 1.5])
def test_the_gradient_of_the_cost_follows_from_the_jacobian(upper):
    """2·Jᵀr is exact at any shapes, also with a coefficient at its bound."""
    separable = problem(bounds=(np.full(3, -np.inf), np.full(3, upper)))
    shapes = np.array([1.1, 2.0])
    solution = separable.solve(shapes)
    assert np.isclose(solution.coefficients, upper).any() == np.isfinite(upper)
    gradient = 2.0 * separable.jacobian(shapes, solution).T @ solution.residual
    expected = approx_fprime(shapes, lambda s: np.sum(separable.solve(s).residual ** 2), 1e-6)
    np.testing.assert_allclose(gradient, expected, rtol=2e-3)


EFFECTS = {
    "joint": "coulomb,viscous,presliding/load:2,stribeck/exponent:1+2,position_friction:1",
    "arm": "coulomb,viscous,stribeck:1+2,torque_lowpass:2,encoder_offset",
}


@pytest.mark.parametrize("name", EFFECTS)
def test_the_refinement_has_the_cost_of_all_rows_and_its_gradient(name):
    model = lieid.Model(ROBOT, EFFECTS[name])
    design = Design(lieid.compile(model), process(recorded(ripple), OPTIONS))
    links, noise = np.zeros(20 + len(model.columns)), np.array([0.2, 0.7])
    links[:20] = ROBOT.link_parameters
    rows = design.rows(model.initial_shapes, links)
    refinement = RefinementProblem(design, rows, model.initial_shapes, links, noise)

    def cost(shapes):
        rows = design.rows(shapes, links)
        factor = combine(rows.factors, 1.0 / noise)
        return factor.misfit(solve(factor).values)

    for shapes in (model.initial_shapes, 0.7 * model.initial_shapes):
        found = refinement.solve(shapes)
        assert found.residual @ found.residual == pytest.approx(cost(shapes), rel=1e-9)
        gradient = 2.0 * refinement.jacobian(shapes, found).T @ found.residual
        steps = 1e-4 * shapes * np.eye(len(shapes))
        expected = [(cost(shapes + h) - cost(shapes - h)) / (2.0 * h.sum()) for h in steps]
        np.testing.assert_allclose(gradient * shapes, expected * shapes, rtol=0.02, atol=1e-2)


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
