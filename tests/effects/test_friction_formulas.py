"""The friction effects against their formulas, at extreme values, and with the temperature."""

import casadi as ca
import numpy as np
import pytest
from plant.recordings import recorded

import lieid_casadi as lieid
from lieid_casadi import plant
from lieid_casadi.effects import Signals, make
from lieid_casadi.effects.registry import REGISTER
from lieid_casadi.errors import EffectError
from lieid_casadi.recording import Processing, process

NAMES = ("q", "dq", "ddq", "sign", "load", "temperature", "time")


def evaluate(label, shape=None, **values):
    """Columns (m, N) of an effect at samples (N,), by CasADi."""
    effect = make(label)
    symbols = {k: ca.SX.sym(k) for k in NAMES}
    states = {s.name: ca.SX.sym(s.name) for s in effect.states}
    shapes = {s.name: ca.SX.sym(s.name) for s in effect.shapes}
    columns = ca.vertcat(*effect.columns(Signals(**symbols, state=states), shapes))
    function = ca.Function("f", [*symbols.values(), *states.values(), *shapes.values()], [columns])
    count = len(next(iter(values.values())))
    given = [np.asarray(values.get(k, np.zeros(count)), dtype=float) for k in (*NAMES, *states)]
    numbers = [s.initial for s in effect.shapes] if shape is None else shape
    return function(*(x[None] for x in given), *numbers).full()


@pytest.fixture
def s():
    rng = np.random.default_rng(0)
    dq = np.concatenate([np.zeros(4), rng.normal(scale=0.3, size=60)])
    signals = {k: rng.normal(size=64) for k in ("q", "load", "temperature", "z")}
    return {**signals, "dq": dq, "sign": np.sign(dq), "time": rng.uniform(0, 900, 64)}


def test_eq8_away_from_rest_is_the_printed_one(s):
    moving = np.abs(s["dq"]) > 0.05
    _, printed = evaluate("load_friction/paper", [0.02], **s)
    exponent = -0.02 * np.abs(s["load"]) / np.abs(np.where(moving, s["dq"], 1.0))
    expected = np.exp(exponent) * s["sign"]
    np.testing.assert_allclose(printed[moving], expected[moving], rtol=1e-3)


def test_the_ten_coefficient_formula_of_the_paper(s):
    """Eq. 8 as one sum, from the effects that make it up."""
    f = {"v1": 3.0, "v2": -1.0, "v3": 0.4, "c": 2.0, "c1": 0.03, "s": 2.6, "s1": 0.2}
    f |= {"t": 0.05, "t1": 0.3, "t2": 0.01}
    total = f["v1"] * evaluate("viscous", **s)[0]
    total += np.array([f["v2"], f["v3"]]) @ evaluate("viscous_polynomial", **s)
    total += np.array([f["c"], f["s"]]) @ evaluate("stribeck/two_width", [f["c1"], f["s1"]], **s)
    total += np.array([f["t"], f["t1"]]) @ evaluate("load_friction/paper", [f["t2"]], **s)
    dq, sgn, load = s["dq"], s["sign"], np.abs(s["load"])
    expected = f["v1"] * dq + f["v2"] * sgn * dq**2 + f["v3"] * dq**3
    expected += f["c"] * sgn * (1 - np.exp(-((dq / f["c1"]) ** 2)))
    expected += f["s"] * sgn * np.exp(-((dq / f["s1"]) ** 2))
    speed = np.sqrt(dq**2 + 1e-6)
    expected += (f["t"] * load + f["t1"] * np.exp(-f["t2"] * load / speed)) * sgn
    np.testing.assert_allclose(total, expected, rtol=1e-12, atol=1e-14)


@pytest.mark.parametrize("label", sorted(REGISTER))
def test_values_and_derivatives_are_finite_everywhere(label):
    """At rest, without load, at extremes: columns, states and their Jacobians."""
    effect = make(label)
    own, past, other = (
        {k: ca.SX.sym(f"{who}_{k}") for k in NAMES} for who in ("own", "past", "other")
    )
    shapes = {p.name: ca.SX.sym(p.name) for p in effect.shapes}
    states = {p.name: ca.SX.sym(p.name) for p in effect.states}
    partner = Signals(**other) if effect.couples else None
    now = Signals(**own, other=partner, state=states)
    out = [*effect.columns(now, shapes)]
    if states:
        out += effect.advance(Signals(**past, state=states), now, shapes)
    variables = ca.vertcat(
        *own.values(), *past.values(), *other.values(), *states.values(), *shapes.values()
    )
    result = ca.vertcat(*out)
    function = ca.Function("f", [variables], [result, ca.jacobian(result, variables)])
    rng = np.random.default_rng(1)
    ends = [[p.initial, p.lower, p.upper] for p in effect.shapes]
    for _ in range(300):
        signals = rng.choice([0.0, 0.0, 1e-12, -1e-3, 0.7, -30.0, 1e4], size=21)
        numbers = [rng.choice(e) for e in ends]
        state = rng.choice([0.0, 0.01, -0.4], size=len(states))
        for value in function(np.concatenate([signals, state, numbers])):
            assert np.isfinite(value.full()).all()


@pytest.mark.parametrize(
    "label",
    [
        "coulomb", "viscous", "stribeck", "stribeck/exponent", "stribeck/two_width",
        "viscous_polynomial", "load_friction", "load_friction/paper", "load_friction/motoring",
        "load_friction/square", "load_friction/stribeck", "temperature_friction/exponential",
        "warm_up",
    ],
)  # fmt: skip
def test_each_column_opposes_motion(label, s):
    """With a positive coefficient none of these gives energy: q̇·column ≥ 0."""
    assert np.all(s["dq"] * evaluate(label, **s) >= 0.0)


ROBOT = lieid.robots.two_link()
FRICTION = plant.JointFriction(np.array([1.0, 0.5]), np.array([2.0, 1.0]), np.zeros(2))
OPTIONS = Processing(cutoff=8.0)


def run(effects, thermal, *, seed, temperature=True):
    arm = plant.Arm(ROBOT, plant.perturbed_inertias(ROBOT, seed=3), FRICTION, effects, thermal)
    sensors = plant.Sensors(rate=200.0, torque_noise=0.02, temperature=temperature)
    series = {"base_frequency": 0.1, "periods": 6}
    return recorded(arm, seed, seconds=60.0, step=0.005, sensors=sensors, **series)


@pytest.fixture(scope="module")
def warming():
    effects = (
        plant.TemperatureFriction(0, viscous_decay=0.03),
        plant.TemperatureFriction(1, viscous_decay=0.02),
    )
    cold = run(effects, plant.Thermal(20.0, 25.0, 30.0), seed=0)
    hot = run(effects, plant.Thermal(32.0, 12.0, 30.0), seed=1)
    return cold, hot


def error_on(recording, fit):
    """RMS per joint of filtered torque, in motion: at rest dry friction is undetermined."""
    (segment,) = process(recording, fit.processing)
    error = segment.filter(segment.tau) - fit.predict_processed(segment)
    return np.sqrt(np.mean(error**2, axis=0, where=np.abs(segment.filter(segment.dq)) > 0.03))


def test_exponential_viscous_friction_carries_over_to_another_temperature(warming):
    cold, hot = warming
    effects = "coulomb,temperature_friction/exponential"
    fit = lieid.identify(lieid.Model(ROBOT, effects), cold, processing=OPTIONS)
    plain = lieid.identify(lieid.Model(ROBOT, "coulomb,viscous"), cold, processing=OPTIONS)
    assert np.all(error_on(hot, fit) < 0.25 * error_on(hot, plain))
    assert np.all(error_on(hot, fit) < 0.03)


def test_a_recording_without_temperature_is_refused(warming):
    cold, _ = warming
    model = lieid.Model(ROBOT, "coulomb,viscous,temperature_friction")
    without = run((), plant.Thermal(), seed=2, temperature=False)
    with pytest.raises(EffectError, match="temp1"):
        lieid.identify(model, without, processing=OPTIONS)
    fit = lieid.identify(model, cold, processing=OPTIONS)
    with pytest.raises(EffectError, match="temperature_friction:1 needs temperature"):
        fit.predict(without)


def test_warm_up_finds_its_time_constant():
    effects = (plant.WarmUp(0, change=-0.4, time_constant=15.0),)
    recording = run(effects, plant.Thermal(), seed=4, temperature=False)
    fit = lieid.identify(
        lieid.Model(ROBOT, "coulomb,viscous,warm_up:1"), recording, processing=OPTIONS
    )
    assert fit.shapes[0] == pytest.approx(15.0, rel=0.1)
    rows = {r["name"] + str(r["joint"]): r["value"] for r in fit.parameter_table()}
    assert rows["warm_up.f_tv1"] == pytest.approx(-0.4 * 2.0, rel=0.1)
    assert rows["warm_up.f_tc1"] == pytest.approx(-0.4 * 1.0, rel=0.15)
