"""States of effects with memory, compared with one CasADi step after the other."""

import casadi as ca
import numpy as np
import pytest

from lieid_casadi.diagnosis.effect_columns import OWN, signals_of, states_along
from lieid_casadi.effects.presliding import Presliding
from lieid_casadi.effects.registry import make


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
    (found,) = states_along(effect, [values[name][:, :, None] for name in OWN], grid)
    before, now = ({name: ca.SX.sym(name) for name in OWN} for _ in range(2))
    z = ca.SX.sym("z")
    signals = signals_of(before)
    signals.state["z"] = z
    for g, row in enumerate(grid):
        shape = {s.name: ca.SX(x) for s, x in zip(effect.shapes, row, strict=True)}
        after = effect.next_states(signals, signals_of(now), shape)
        step = ca.Function("step", [z, *before.values(), *now.values()], after)
        for place in range(2):
            own = np.array([values[name][:, place] for name in OWN]).T
            expected = [0.0]
            for k in range(samples - 1):
                expected.append(float(step(expected[-1], *own[k], *own[k + 1])))
            np.testing.assert_allclose(found[:, place, g], expected, rtol=1e-9, atol=1e-12)
