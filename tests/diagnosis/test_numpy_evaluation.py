"""Evaluation of CasADi expressions, and of effects with memory, by NumPy, compared with CasADi."""

import casadi as ca
import numpy as np
import pytest

import lieid_casadi as lieid
from lieid_casadi.effects import ArmEffect, Signals
from lieid_casadi.effects.presliding import Presliding
from lieid_casadi.effects.registry import REGISTER, make
from lieid_casadi.expressions.effect_function import OWN, ArrayFunction, EffectFunction

X, Y = ca.SX.sym("x"), ca.SX.sym("y")
EXPRESSIONS = {
    "arithmetic": (X + Y) * (X - Y) / (1.0 + X**2) - 3.0,
    "powers": ca.sqrt(ca.fabs(X)) + ca.fabs(X) ** 1.7 + Y**2,
    "trigonometric": ca.sin(X) * ca.cos(Y) + ca.tan(0.3 * X) + ca.atan2(X, Y),
    "exponential": ca.exp(-(X**2)) + ca.log(1.0 + Y**2) + ca.expm1(X) + ca.log1p(ca.fabs(Y)),
    "steps": ca.sign(X) + ca.if_else(X > Y, X, Y) + ca.fmax(X, 0.1) + ca.fmin(Y, 0.2),
    "logic": ca.logic_and(X > 0, Y > 0) + ca.logic_or(X > 0, Y > 0) + ca.logic_not(X > 0),
    "saturating": ca.tanh(X) + ca.erf(Y) + ca.floor(3.0 * X) + ca.fmod(Y, 0.7),
}


@pytest.mark.parametrize("name", EXPRESSIONS)
def test_expressions(name):
    expression = EXPRESSIONS[name]
    random = np.random.default_rng(0)
    x, y = random.normal(size=(2, 50))
    expected = ca.Function("f", [X, Y], [expression]).map(50)(x[None], y[None]).full()[0]
    (found,) = ArrayFunction([X, Y], [expression])(x, y)
    np.testing.assert_allclose(found, expected, rtol=1e-13, atol=1e-13)


def test_constant_results():
    one, x = ArrayFunction([X], [ca.SX(1.0), X])(np.arange(3.0))
    assert one == 1.0
    np.testing.assert_array_equal(x, np.arange(3.0))


@pytest.mark.parametrize(
    "label", [x for x in sorted(REGISTER) if not isinstance(make(x), ArmEffect)]
)
def test_every_effect_has_the_columns_of_the_compiled_model(label):
    from lieid_casadi import plant
    from lieid_casadi.identification.regression.segment_columns import signals_along
    from lieid_casadi.recording import Processing, process

    robot = lieid.robots.two_link()
    effect = make(label)
    spec = f"{label}:1<2" if effect.couples else f"{label}:1"
    model = lieid.Model(robot, spec)
    motion = plant.FourierTrajectory(robot, base_frequency=0.2, seed=1)
    t = np.arange(0.0, 5.0, 0.005)
    q, dq, _ = motion.at(t)
    temperature = 20.0 + np.column_stack([t, 2.0 * t])
    recording = lieid.Recording.from_arrays(t, q, dq, np.zeros_like(q), temperature=temperature)
    (segment,) = process(recording, Processing(cutoff=8.0))
    load = 3.0 * np.sin(segment.q)
    signals = signals_along(segment, load, None)
    places = [(0, 1 if effect.couples else None)]
    shapes = np.array([[shape.initial for shape in effect.shapes]])
    found = EffectFunction(effect).columns(signals, places, shapes)[:, 0, 0]
    expected = lieid.compile(model).effect_columns(
        segment.q, segment.dq, segment.ddq, load=load,
        temperature=segment.temperature, time=segment.t - segment.t[0],
        dead_zone=segment.dead_zone,
    )[:, 0]  # fmt: skip
    np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-9)


class NonlinearMemory(Presliding):
    """A state whose step is no affine function of it."""

    def advance(self, before, now, shape):
        z = before.state["z"]
        return [z + 0.1 * (ca.sin(now.q / shape["w"]) - z**3)]


@pytest.mark.parametrize(
    ("effect", "shapes"),
    [
        (make("presliding"), [[0.003], [0.1]]),
        (make("presliding/lugre"), [[0.02, 0.3, 0.1], [0.1, 2.0, 0.02], [0.003, 0.1, 1.0]]),
        (NonlinearMemory(), [[0.3], [1.0]]),
    ],
)
def test_states_are_those_of_single_steps(effect, shapes):
    samples, grid = 53, np.array(shapes)  # no square, so that the last block is not full
    time = np.linspace(0.0, 4.0, samples)[:, None] * np.ones(2)
    values = {name: np.zeros((samples, 2)) for name in OWN} | {
        "q": np.sin([2.0, 5.0] * time), "dq": [2.0, 5.0] * np.cos([2.0, 5.0] * time), "time": time,
    }  # fmt: skip
    values["q"][20, 0] = values["dq"][30, 1] = np.nan
    places = [(0, None), (1, None)]
    # f_c·z/w, at values that are the same at both places, and that differ between them
    found = EffectFunction(effect).columns(values, places, grid)[..., 0] * grid[:, 0]
    apart = np.stack([grid, grid[::-1]])
    both = EffectFunction(effect).columns(values, places, apart)[..., 0] * apart[:, :, 0]
    np.testing.assert_array_equal(both[:, 0], found[:, 0])
    np.testing.assert_array_equal(both[:, 1], found[:, 1, ::-1])
    before, now = ({name: ca.SX.sym(name) for name in OWN} for _ in range(2))
    z = ca.SX.sym("z")
    signals = Signals(**before)
    signals.state["z"] = z
    for g, row in enumerate(grid):
        shape = {s.name: ca.SX(x) for s, x in zip(effect.shapes, row, strict=True)}
        after = effect.next_states(signals, Signals(**now), shape)
        step = ca.Function("step", [z, *before.values(), *now.values()], after)
        for place in range(2):
            own = np.array([values[name][:, place] for name in OWN]).T
            expected = [0.0]
            for k in range(samples - 1):
                expected.append(float(step(expected[-1], *own[k], *own[k + 1])))
            np.testing.assert_allclose(found[:, place, g], expected, rtol=1e-9, atol=1e-12)
