"""Effects with memory: Dahl and LuGre against their differential equations, at any rate."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import lieid_casadi as lieid
from lieid_casadi import plant
from lieid_casadi.expressions.model_functions import ModelFunctions, states_along
from lieid_casadi.recording import Processing

ROBOT = lieid.robots.two_link()
WIDTH = 0.02


def loop(t):
    """Two joints moving back and forth, with reversals at different positions."""
    q = np.column_stack([np.sin(t) + 0.3 * np.sin(3.1 * t), 0.2 * np.cos(2 * t)])
    dq = np.column_stack([np.cos(t) + 0.93 * np.cos(3.1 * t), -0.4 * np.sin(2 * t)])
    return q, dq


def hysteresis(t, *, label="presliding", shapes=None):
    """First joint's first column along the loop."""
    arm = lieid.compile(lieid.Model(ROBOT, f"{label}:1"))
    q, dq = loop(t)
    shapes = [WIDTH] if shapes is None else shapes
    return arm.effect_columns(q, dq, 0 * q, time=t, shapes=shapes)[:, 0]


def dahl_by_integration(t):
    def slope(time, z):
        velocity = loop(np.array([time]))[1][0, 0]
        return velocity - abs(velocity) * z / WIDTH

    solution = solve_ivp(slope, (t[0], t[-1]), [0.0], t_eval=t, max_step=2e-3, rtol=1e-8)
    return solution.y[0] / WIDTH


def test_dahl_solves_its_equation():
    t = np.arange(0.0, 8.0, 0.01)
    np.testing.assert_allclose(hysteresis(t)[:, 0], dahl_by_integration(t), atol=2e-3)


def test_one_long_step_is_many_short_ones():
    """In one direction the result depends on the positions alone, to rounding."""
    model = lieid.Model(ROBOT, "presliding:1")
    rng = np.random.default_rng(0)
    fine = np.zeros((401, 2))
    fine[:, 0] = np.concatenate([[0.0], np.cumsum(rng.uniform(0, 1e-3, 400))])
    ends = []
    for rows in ([0, 400], [0, 7, 400], np.arange(401)):
        columns = lieid.compile(model).effect_columns(fine[rows], 0 * fine[rows], 0 * fine[rows])
        ends.append(columns[-1, 0, 0])
    np.testing.assert_allclose(ends, -np.expm1(-fine[-1, 0] / 0.01), rtol=1e-13)


@pytest.mark.parametrize("rate", [50, 100, 400])
def test_the_loop_is_the_same_at_any_rate(rate):
    """Reversals lie between samples; the states at common instants agree with 20 kHz."""
    fine = np.arange(0.0, 8.0, 5e-5)
    step = 20_000 // rate
    error = np.abs(hysteresis(fine[::step])[:, 0] - hysteresis(fine)[::step, 0])
    assert error.max() < 100.0 / rate**3


def test_lugre_solves_its_equation():
    width, excess, stribeck = 0.02, 0.5, 0.3

    def slope(time, z):
        velocity = loop(np.array([time]))[1][0, 0]
        scale = width * (1 + excess * np.exp(-((velocity / stribeck) ** 2)))
        return velocity - abs(velocity) * z / scale

    t = np.arange(0.0, 6.0, 0.002)
    z = solve_ivp(slope, (0.0, 6.0), [0.0], t_eval=t, max_step=1e-3, rtol=1e-8).y[0]
    rate = np.array([slope(time, value) for time, value in zip(t, z, strict=True)])
    columns = hysteresis(t, label="presliding/lugre", shapes=[width, excess, stribeck])
    np.testing.assert_allclose(columns[:, 0], z / width, atol=2e-2)
    assert np.median(np.abs(columns[:, 1] - rate)) < 2e-3


@pytest.mark.parametrize("samples", [1, 2, 773])
def test_any_number_of_samples(samples):
    t = np.linspace(0.0, 5.0, samples)
    q, dq = loop(t)
    model = lieid.Model(ROBOT, "presliding")
    states = states_along(
        ModelFunctions(model),
        {"q": q, "dq": 0 * dq, "shapes": np.full(2, WIDTH), "dead_zone": np.zeros(2)},
    )
    z, expected = np.zeros(2), [np.zeros(2)]
    for moved in np.diff(q, axis=0):
        side = np.sign(moved) * WIDTH
        z = side + (z - side) * np.exp(-np.abs(moved) / WIDTH)
        expected.append(z)
    np.testing.assert_allclose(states, np.array(expected[:samples]), atol=1e-15)


def run(arm, seed, t, rate=500.0):
    motion = plant.FourierTrajectory(ROBOT, base_frequency=0.1, periods=2, seed=seed)
    q, dq, ddq = motion.at(t)
    sensors = plant.Sensors(rate=rate, torque_noise=0.02, velocity_noise=1e-3)
    return plant.measure_along(arm, t, q, dq, ddq, sensors=sensors, seed=seed)


@pytest.fixture(scope="module")
def hysteretic():
    friction = plant.JointFriction(np.array([2.0, 1.0]), np.array([0.6, 0.3]), np.zeros(2))
    effects = (plant.Presliding(0, 0.05), plant.Presliding(1, 0.08))
    return plant.Arm(ROBOT, plant.perturbed_inertias(ROBOT, seed=3), friction, effects)


def test_the_width_is_identified_and_predicts_a_new_recording(hysteretic):
    t = np.arange(0.0, 20.0, 0.001)
    train, test = run(hysteretic, 0, t), run(hysteretic, 1, t)
    processing = Processing(cutoff=10.0)
    fit = lieid.identify(lieid.Model(ROBOT, "viscous,presliding"), train, processing=processing)
    np.testing.assert_allclose(fit.shapes, [0.05, 0.08], rtol=0.05)
    rows = {r["name"] + str(r["joint"]): r["value"] for r in fit.parameter_table()}
    np.testing.assert_allclose(
        [rows["presliding.f_c1"], rows["presliding.f_c2"]], [2.0, 1.0], rtol=0.03
    )
    dry = lieid.identify(lieid.Model(ROBOT, "viscous,coulomb"), train, processing=processing)
    error = np.std(fit.predict(test) - test.tau, axis=0)
    assert np.all(error < 0.5 * np.std(dry.predict(test) - test.tau, axis=0))


def test_state_is_reset_at_each_segment(hysteretic):
    """A recording with a gap is predicted as its two parts are, each from rest."""
    t = np.arange(0.0, 6.0, 0.002)
    whole = run(hysteretic, 2, t)
    first, second = whole.cut(0.0, 3.0), whole.cut(3.4, 6.0)
    fit = lieid.identify(
        lieid.Model(ROBOT, "viscous,presliding"), whole, processing=Processing(cutoff=10.0)
    )
    joined = fit.predict(whole.at((t < 3.0) | (t >= 3.4)))
    apart = np.concatenate([fit.predict(first), fit.predict(second)])
    np.testing.assert_allclose(joined, apart, atol=1e-9)
    # the second part alone starts with z = 0, inside the whole it does not
    inside = fit.predict(whole)[np.searchsorted(whole.t, 3.4)]
    assert np.abs(inside - fit.predict(second)[0]).max() > 0.1


def test_columns_need_states():
    import casadi as ca

    functions = ModelFunctions(lieid.Model(ROBOT, "presliding"))
    with pytest.raises(lieid.LieidError, match="presliding:1, presliding:2 has memory"):
        functions.model.effect_columns(functions.signals, ca.SX(2, 1))
