"""Smooth functions of signals as an effect: fit, file, C code, and where they are zero."""

from dataclasses import replace

import casadi as ca
import numpy as np
import pytest
from exporters.c_arms import torque_of
from hypothesis import given
from hypothesis import strategies as st
from plant.recordings import recorded as measured

import lieid_casadi as lieid
from lieid_casadi import plant
from lieid_casadi.effects import make
from lieid_casadi.effects.effect import EffectSignals
from lieid_casadi.effects.smooth import Smooth
from lieid_casadi.errors import EffectError
from lieid_casadi.recording import Processing

PANDA = lieid.robots.panda()
KINDS = ("q", "dq", "ddq", "load.dq", "dq.q5", "q5", "tau5")
NOISE = 0.05
OPTIONS = Processing(cutoff=8.0)


def recorded(seed, hidden=lambda q, dq: 0.0):
    """A Panda at 100 Hz with friction and a further torque on joint 4."""
    friction = plant.JointFriction(np.full(7, 0.6), np.full(7, 0.8), np.zeros(7))
    arm = plant.Arm(PANDA, PANDA.link_parameters, friction)
    sensors = plant.Sensors(rate=100.0, torque_noise=NOISE)
    run = measured(arm, seed, seconds=15.0, step=0.01, sensors=sensors)
    tau = run.tau.copy()
    tau[:, 3] += hidden(run.q, run.dq)
    return replace(run, tau=tau)


@pytest.fixture(scope="module")
def run():
    return recorded(1)


def fitted(run, effects, **options):
    model = lieid.Model(PANDA, f"coulomb,viscous,offset,{effects}")
    return lieid.identify(model, run, processing=OPTIONS, **options)


@pytest.mark.parametrize("kind", KINDS)
def test_file_and_symbolic_torque_are_those_of_the_fit(run, kind, tmp_path):
    fit = fitted(run, f"smooth/{kind}:4")
    assert np.isfinite(fit.values).all()
    fit.save(tmp_path / "fit.json")
    loaded = lieid.Fit.load(tmp_path / "fit.json")
    torque = fit.predict(run)
    np.testing.assert_allclose(loaded.predict(run), torque, rtol=0, atol=1e-12)
    function = lieid.symbolic(loaded).inverse_dynamics  # evaluated by CasADi, the fit by C
    at = slice(100, 200)
    by_casadi = function(run.q[at].T, run.dq[at].T, np.zeros((7, 100))).full().T
    by_c = torque_of(fit, run.q[at], run.dq[at], np.zeros((100, 7)))
    np.testing.assert_allclose(by_casadi, by_c, rtol=0, atol=1e-10)


@pytest.mark.parametrize("kind", ["q", "dq", "q5", "q.dq", "dq.q5"])
def test_zero_where_the_data_do_not_reach(run, kind):
    fit = fitted(run, f"smooth/{kind}:4")
    others = np.arange(len(fit.parameters)) < 10 * 7 + 3 * 7
    none = replace(fit, parameters=np.where(others, fit.parameters, 0.0))
    reach = np.abs(run.dq).max(axis=0), np.abs(run.q).max(axis=0)
    q, dq = 3.0 * np.tile(reach[1], (2, 1)), 3.0 * np.tile(reach[0], (2, 1)) * [[1.0], [-1.0]]
    np.testing.assert_array_equal(torque_of(fit, q, dq, 0 * q), torque_of(none, q, dq, 0 * q))
    motion = run.q[50::100], run.dq[50::100], 0.0 * run.q[50::100]
    assert np.all(torque_of(fit, *motion)[:, 3] != torque_of(none, *motion)[:, 3])


def test_a_function_of_another_joint_is_found_to_the_noise():
    def hidden(q, dq):
        return 0.8 * np.sin(1.7 * q[:, 4] + 0.4)

    train, test = recorded(1, hidden), recorded(2, hidden)
    for effects, error in (("armature:4", 0.1), ("smooth/q5:4", 0.0)):
        fit = fitted(train, effects)
        rms = lieid.compare(fit, test).rms[3]
        floor = NOISE * np.sqrt(8.0 / 50.0)  # of white noise below the cut-off
        assert rms > error if error else rms < 1.3 * floor


def test_friction_that_jumps_and_bends_is_found_to_the_noise():
    """Friction of a Stribeck form, stronger in one direction, in no effect of the model."""

    def hidden(q, dq):
        v = dq[:, 3]
        return np.sign(v) * (1.5 * np.exp(-((v / 0.25) ** 2)) + 0.2) + 0.3 * np.exp(-np.abs(v))

    train, test = recorded(1, hidden), recorded(2, hidden)
    missing = lieid.compare(fitted(train, ""), test).rms[3]
    smooth = lieid.compare(fitted(train, "smooth/dq:4"), test).rms[3]
    assert smooth < 0.25 * missing


def test_the_same_data_give_the_same_knots_and_other_data_others(run):
    one, same = (fitted(run, "smooth/q.dq:4") for _ in range(2))
    np.testing.assert_array_equal(one.shapes, same.shapes)
    np.testing.assert_array_equal(one.values, same.values)
    assert np.all(one.std[len(one.values) :] == 0.0)
    assert np.abs(fitted(recorded(5), "smooth/q.dq:4").shapes - one.shapes).max() > 1e-3
    low, high, speed = one.shapes
    assert np.quantile(run.q[:, 3], 0.004) < low < np.quantile(run.q[:, 3], 0.02)
    assert np.quantile(run.q[:, 3], 0.98) < high < np.quantile(run.q[:, 3], 0.996)
    assert 0.97 * np.abs(run.dq[:, 3]).max() < speed < np.abs(run.dq[:, 3]).max()


def test_functions_are_orthonormal_and_without_what_friction_describes():
    """Simpson's rule, not the grid of the effect."""
    from scipy.integrate import simpson

    effect = make("smooth/dq")
    assert effect.label == "smooth/dq"
    v, sign = ca.SX.sym("v"), ca.SX.sym("s")
    from lieid_casadi.effects import Signals

    zero = ca.SX(0)
    signals = Signals(zero, v, zero, sign, zero, zero, zero)
    columns = ca.vertcat(*effect.columns(signals, {"dq_max": ca.SX(2.0)}))
    x = np.linspace(1e-9, 2.0, 2001)
    function = ca.Function("f", [v, sign], [columns])
    sides = [function(s * x[None], np.full((1, 2001), s)).full() for s in (1.0, -1.0)]
    known = [np.ones_like(x), x, np.sign(x)]
    for column in range(len(effect.coefficients)):
        for k, values in enumerate(known):
            signs = (1.0, 1.0) if k == 0 else (1.0, -1.0)
            total = sum(
                s * simpson(side[column] * values, x=x)
                for s, side in zip(signs, sides, strict=True)
            )
            assert abs(total) < 4.0 * 1e-3
    count = range(len(effect.coefficients))
    gram = [[sum(simpson(s[a] * s[b], x=x) for s in sides) / 4.0 for a in count] for b in count]
    np.testing.assert_allclose(gram, np.eye(len(count)), atol=1e-2)


@given(st.floats(-40.0, 30.0), st.floats(1.0, 90.0), st.floats(0.1, 5.0))
def test_parts_of_another_joints_torque_are_in_proportion_to_it_and_orthonormal(low, width, top):
    """By Gauss and Legendre's rule; the load of a kept model has its mean, too."""
    nodes, weights = np.polynomial.legendre.leggauss(4)
    load, half = low + width * (nodes + 1.0) / 2.0, top * (nodes + 1.0) / 2.0
    speed, both = np.append(-half, half), np.append(weights, weights) / 4.0
    load, speed = (x.ravel() for x in np.meshgrid(load, speed, indexing="ij"))
    weight = np.outer(weights / 2.0, both).ravel()
    torque = 0.3 * load + 2.0 * np.sign(speed) + 0.7 * speed
    v, tau, none = ca.SX.sym("v", 2), ca.SX.sym("tau", 2), ca.SX(2, 1)
    signals = EffectSignals(none, v, none, ca.sign(v), tau, none, ca.SX(0))
    for whole in (False, True):
        effect = Smooth(option="tau2", whole=whole)
        ranges = dict(zip([s.name for s in effect.shapes], (low, low + width, top), strict=True))
        columns = effect.columns(signals.of(0), {k: ca.SX(x) for k, x in ranges.items()})
        function = ca.Function("f", [v, tau], [ca.vertcat(*columns)])
        one = np.full(len(load), 1.7)  # of the joint itself, on which nothing depends
        matrix = function(np.vstack([one, speed]), np.vstack([one, load])).full().T
        np.testing.assert_allclose(
            (matrix * weight[:, None]).T @ matrix, np.eye(3 + whole), rtol=0, atol=1e-9
        )
        target = torque if whole else torque - weight @ torque
        coefficients = matrix.T @ (weight * target)
        np.testing.assert_allclose(matrix @ coefficients, target, rtol=0, atol=1e-9 * 100.0)


@pytest.mark.parametrize("option", ["tau", "tau0", "tau2.q", "q.tau2", "tau2.tau3"])
def test_the_torque_of_another_joint_stands_alone(option):
    with pytest.raises(EffectError, match="the torque of another joint, as in smooth/tau5"):
        Smooth(option=option)


@pytest.mark.parametrize("option", ["dq", "q", "load", "q.load", "dq.load"])
def test_a_whole_function_contains_a_constant_and_what_is_linear_in_its_signals(option):
    """Splines of a warped speed are no straight line, but close to one."""
    from lieid_casadi.effects import Signals

    random = np.random.default_rng(2)
    angle, speed, load = random.uniform(-1.0, 1.0, (3, 400))
    values = {"q": angle, "dq": speed, "load": load}
    own = [ca.SX.sym(name) for name in values]
    zero, sign = ca.SX(0), ca.sign(own[1])
    signals = Signals(own[0], own[1], zero, sign, own[2], zero, zero)
    known = [np.ones(400)] if "dq" not in option else [np.sign(speed), speed]
    known += [x for name, x in values.items() if name in option.split(".")[:1] and name != "dq"]
    rest = {}
    for whole in (False, True):
        effect = Smooth(option=option, whole=whole)
        ranges = {s.name: ca.SX(-1.0 if s.name.endswith("low") else 1.0) for s in effect.shapes}
        columns = ca.vertcat(*effect.columns(signals, ranges))
        matrix = ca.Function("f", own, [columns])(*(x[None] for x in values.values())).full().T
        fitted = [x - matrix @ np.linalg.lstsq(matrix, x, rcond=None)[0] for x in known]
        rest[whole] = max(
            np.linalg.norm(r) / np.linalg.norm(x) for r, x in zip(fitted, known, strict=True)
        )
    assert rest[True] < 0.03
    assert rest[False] > 0.3


def test_what_a_function_cannot_describe_does_not_spoil_other_motion():
    """Of two signals a motion shows a curve alone, on which large coefficients cancel each other.

    A narrow bump along the angle of joint 2 is in no function of both angles with few splines.
    """
    robot, none = lieid.robots.two_link(), plant.JointFriction(*np.zeros((3, 2)))
    bump = plant.ForeignTorque(1, function=lambda s: 1.0 / (1.0 + (20.0 * s.q[..., 1] - 4.0) ** 2))
    arm = plant.Arm(robot, robot.link_parameters, none).with_effects(bump)
    ratios = []
    for seed in range(5):
        train, other = (measured(arm, s, seconds=16.0, step=0.005) for s in (seed, seed + 10))
        models = (lieid.Model(robot, effects) for effects in ("offset", "offset,smooth/q.q1:2"))
        fits = (lieid.identify(model, train) for model in models)
        plain, fitted = (lieid.compare(fit, other).rms[1] for fit in fits)
        ratios.append(fitted / plain)
    assert np.exp(np.mean(np.log(ratios))) < 1.4, ratios
