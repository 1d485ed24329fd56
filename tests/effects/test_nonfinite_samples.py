"""Effects with memory hold their state at samples that are not finite, in every evaluation."""

import ctypes

import numpy as np
import pytest
from exporters.c_arms import library, made_fit, pointer, sample_type

import lieid_casadi as lieid
from lieid_casadi.compiled.batch_evaluation import states_along as compiled_states
from lieid_casadi.compiled.kernels import Kernels
from lieid_casadi.exporters.export import export
from lieid_casadi.expressions.model_functions import ModelFunctions, states_along

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


def test_held_states_in_a_diagnosis():
    """The NumPy evaluation of candidates uses the same rule."""
    from lieid_casadi.diagnosis.effect_columns import OWN, states_along
    from lieid_casadi.effects import make

    motion = signals("q", np.nan)
    rows = {k: motion[k][:, :1] for k in ("q", "dq")} | {"time": motion["time"]}
    own = [rows.get(name, np.zeros((200, 1)))[:, :, None] for name in OWN]
    (states,) = states_along(make("presliding"), own, np.array([[0.01]]))
    # the steps are composed in another order; states are about 0.01
    np.testing.assert_allclose(states[:, 0, 0], by_casadi(motion)[:, 0], rtol=1e-12, atol=1e-16)
