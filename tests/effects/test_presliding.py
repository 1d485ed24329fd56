"""Effects with memory: Dahl and LuGre against their equations, at any rate, with bad samples."""

import ctypes

import numpy as np
import pytest
from exporters.c_arms import library, made_fit, pointer, sample_type
from plant.recordings import recorded
from scipy.integrate import solve_ivp

import lieid_casadi as lieid
from lieid_casadi import plant
from lieid_casadi.compiled.batch_evaluation import states_along as compiled_states
from lieid_casadi.compiled.kernels import Kernels
from lieid_casadi.exporters.export import export
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


def test_the_width_of_lugre_is_that_of_the_middle_of_a_step():
    """Its error falls with the square of the step, as that of a width at either end does not."""

    def slope(time, z):
        dq = 0.5 * time
        return dq - abs(dq) * z / (0.05 * (1 + 2.0 * np.exp(-((dq / 0.1) ** 2))))

    exact = solve_ivp(slope, (0.0, 0.4), [0.0], rtol=1e-11, atol=1e-14).y[0, -1]
    arm, errors = lieid.compile(lieid.Model(ROBOT, "presliding/lugre:1")), []
    for step in (0.04, 0.02):
        t = np.arange(0.0, 0.4 + 1e-9, step)
        q, dq = (np.outer(x, [1.0, 0.0]) for x in (0.25 * t**2, 0.5 * t))
        z = 0.05 * arm.effect_columns(q, dq, 0 * q, time=t, shapes=[0.05, 2.0, 0.1])[-1, 0, 0]
        errors.append(abs(z - exact))
    assert errors[0] > 1e-7
    assert errors[1] < errors[0] / 3.3


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


def run(arm, seed, seconds, step):
    sensors = plant.Sensors(rate=500.0, torque_noise=0.02, velocity_noise=1e-3)
    return recorded(
        arm, seed, seconds=seconds, step=step, sensors=sensors, base_frequency=0.1, periods=2
    )


@pytest.fixture(scope="module")
def hysteretic():
    friction = plant.JointFriction(np.array([2.0, 1.0]), np.array([0.6, 0.3]), np.zeros(2))
    effects = (plant.Presliding(0, 0.05), plant.Presliding(1, 0.08))
    return plant.Arm(ROBOT, plant.perturbed_inertias(ROBOT, seed=3), friction, effects)


def test_the_width_is_identified_and_predicts_a_new_recording(hysteretic):
    train, test = (run(hysteretic, seed, 20.0, 0.001) for seed in (0, 1))
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
    whole = run(hysteretic, 2, 6.0, 0.002)
    t = whole.t
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


MODEL = lieid.Model(lieid.robots.two_link(), "presliding:1,presliding/lugre:2")
BAD = 40


def signals(name="q", value=0.1):
    """A motion of 200 samples with both joints reversing; one value at sample BAD is replaced."""
    t = np.linspace(0.0, 6.0, 200)
    motion = {
        "q": np.column_stack([np.sin(t), 0.4 * np.cos(2 * t)]),
        "dq": np.column_stack([np.cos(t), -0.8 * np.sin(2 * t)]),
        "time": t[:, None].copy(),
        "shapes": MODEL.initial_shapes,
        "dead_zone": np.zeros(2),
    }
    motion[name][BAD, 0] = value
    return motion


def by_casadi(motion):
    return states_along(ModelFunctions(MODEL), motion)


def by_compiled_batches(motion):
    return compiled_states(Kernels(ModelFunctions(MODEL), lanes=1), motion)


@pytest.mark.parametrize("evaluate", [by_casadi, by_compiled_batches])
@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("name", ["q", "dq", "time"])
def test_the_state_is_held_and_recovers(evaluate, name, value):
    motion = signals()
    motion[name][BAD, 0] = value
    states, undisturbed = evaluate(motion), evaluate(signals())
    assert np.isfinite(states).all()
    affected = [0, 1] if name == "time" else [0]
    for k in (BAD, BAD + 1):  # the bad sample ends one step and begins the next
        np.testing.assert_array_equal(states[k, affected], states[BAD - 1, affected])
    assert np.abs(states[BAD + 2] - states[BAD + 1]).max() > 0.0
    # the memory fades within a few widths (0.01 rad) of motion
    np.testing.assert_allclose(states[-1], undisturbed[-1], atol=1e-12)


def test_exported_c_holds_the_state(tmp_path):
    fit = made_fit(MODEL.robot, "presliding:1,presliding/lugre:2")
    export(fit, tmp_path / "arm", to="c")
    c, state, zero = library(tmp_path / "arm"), ctypes.create_string_buffer(4096), np.zeros(2)
    motion, torque = signals("q", np.nan), np.empty((200, 2))
    c.arm_begin(state)
    for k in range(len(torque)):
        sample = sample_type(2)()
        sample.q[:], sample.dq[:] = motion["q"][k].tolist(), motion["dq"][k].tolist()
        sample.time = float(motion["time"][k, 0])
        c.arm_advance(state, ctypes.byref(sample), None)
        c.arm_effect_torque(ctypes.byref(sample), pointer(zero), state, None, pointer(torque[k]))
    motion["shapes"] = fit.shapes
    held = by_casadi(motion)[:, 0] / fit.shapes[0]
    expected = fit.effect_coefficients[0] * held
    np.testing.assert_allclose(torque[:, 0], expected, rtol=1e-12, atol=1e-13)
