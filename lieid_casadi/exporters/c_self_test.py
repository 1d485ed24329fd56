"""Inputs and results of CasADi that the self-test of exported C compares with."""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from lieid_casadi.exporters.c_functions import ExportExpressions, ExportSymbols
from lieid_casadi.identification.fit import Fit

Array = NDArray[np.float64]
PACE = 2.0  # rad/s of the motion q = … cos(PACE·t): it reverses at t = 0, 1.57 and 3.14 s
TIMES = (0.0, 0.01, 0.02, 0.05, 0.1, 0.3, 0.8, 1.56, 1.58, 1.6, 2.2, 3.05, 3.15)  # s
SMOOTHING = 0.05  # v0, rad/s, of the smooth sign


@dataclass(frozen=True, eq=False)
class SelfTestData:
    """Samples of one motion (K, ·) and the results of each function (K, size).

    Results named ``…_smooth`` belong to the sign tanh(q̇/v0), v0 (n,); the others to the sharp one.
    """

    inputs: dict[str, Array]
    v0: Array
    results: dict[str, Array]


def self_test_data(fit: Fit) -> SelfTestData:
    """Evaluate the model, with numbers as inputs, along a motion through the joints' ranges.

    Joints start at rest, so that sgn(0) = 0 occurs.
    """
    inputs = _motion(fit)
    v0 = np.full(fit.model.n, SMOOTHING)
    machine = _Evaluator(fit)
    results = machine.rigid(inputs)
    inputs["load"] = results["rigid_torque"]
    for ending, sign in (("", np.sign(inputs["dq"])), ("_smooth", np.tanh(inputs["dq"] / v0))):
        for name, values in machine.effects(inputs | {"sign": sign}).items():
            results[name + ending] = values
    return SelfTestData(inputs, v0, results)


def _motion(fit: Fit) -> dict[str, Array]:
    robot, random = fit.model.robot, np.random.default_rng(1)
    lower = np.nan_to_num(robot.limit("position_lower"), nan=-np.pi, posinf=np.pi, neginf=-np.pi)
    upper = np.nan_to_num(robot.limit("position_upper"), nan=np.pi, posinf=np.pi, neginf=-np.pi)
    time = np.array(TIMES)
    reach = random.uniform(-0.3, 0.3, robot.n) * np.minimum(upper - lower, 2.0 * np.pi)
    angle = PACE * time[:, None]
    middle = 0.5 * (lower + upper)
    q = middle + random.uniform(-0.1, 0.1, robot.n) * (upper - lower) + reach * np.cos(angle)
    mean = 0.0 if fit.temperature_mean is None else fit.temperature_mean
    return {
        "q": q,
        "dq": -reach * PACE * np.sin(angle),
        "ddq": -reach * PACE**2 * np.cos(angle),
        "dq_r": random.normal(0.0, 1.0, q.shape),
        "ddq_r": random.normal(0.0, 3.0, q.shape),
        "temperature": mean + random.uniform(-10.0, 10.0, q.shape),
        "time": time[:, None],
    }


class _Evaluator:
    """Evaluation of the functions of a fit by CasADi, with the numbers as inputs."""

    def __init__(self, fit: Fit) -> None:
        self._fit, model = fit, fit.model
        self._now, self._before = ExportSymbols.of(fit), ExportSymbols.of(fit, "before_")
        numbers = [
            ca.SX.sym("links", 10 * model.n),
            ca.SX.sym("coefficients", len(model.columns)),
            ca.SX.sym("shapes", len(model.shapes)),
        ]
        self._expressions = ExportExpressions(fit, self._now, *numbers)
        self._arguments = [*_all(self._now), *_all(self._before), *numbers]
        self._numbers = [fit.link_parameters, fit.effect_coefficients, fit.shapes]

    def rigid(self, inputs: dict[str, Array]) -> dict[str, Array]:
        e = self._expressions
        return {
            name: self._along(getattr(e, name), inputs)
            for name in (
                "rigid_torque", "gravity", "mass_matrix", "regressor", "slotine_li_regressor",
            )
        }  # fmt: skip

    def effects(self, inputs: dict[str, Array]) -> dict[str, Array]:
        e, model, count = self._expressions, self._fit.model, len(inputs["q"])
        results = {}
        if model.states:
            states = np.tile(model.initial_states, (count, 1))
            after = self._function(e.advance(self._before))
            for k in range(1, count):
                states[k] = self._at(after, inputs | {"states": states}, k, k - 1)
            results["states"] = states
            inputs = inputs | {"states": states}
        names = ["base_regressor", "friction", "torque"] + ["effect_columns"] * bool(model.columns)
        return results | {name: self._along(getattr(e, name), inputs) for name in names}

    def _along(self, matrix: ca.SX, inputs: dict[str, Array]) -> Array:
        function = self._function(matrix)
        return np.array([self._at(function, inputs, k, k) for k in range(len(inputs["q"]))])

    def _function(self, matrix: ca.SX) -> ca.Function:
        return ca.Function("f", self._arguments, [ca.densify(matrix)])

    def _at(self, function: ca.Function, inputs: dict[str, Array], now: int, before: int) -> Array:
        """Return a matrix at sample ``now``, row after row."""
        values = [*self._row(inputs, now), *self._row(inputs, before), *self._numbers]
        return np.array(function(*values)).ravel()

    def _row(self, inputs: dict[str, Array], k: int) -> list[Array]:
        n, model = self._fit.model.n, self._fit.model
        mean = 0.0 if self._fit.temperature_mean is None else self._fit.temperature_mean
        row = {name: values[k] for name, values in inputs.items()}
        zero, q = np.zeros(n), row["q"]
        return [
            q, np.sin(q), np.cos(q), row["dq"], row["ddq"], row["dq_r"], row["ddq_r"],
            row.get("sign", zero), row.get("load", zero), row["temperature"] - mean,
            row["time"], row.get("states", np.zeros(len(model.states))),
        ]  # fmt: skip


def _all(symbols: ExportSymbols) -> list[ca.SX]:
    m, s = symbols.motion, symbols
    return [
        m.q, m.sin, m.cos, m.dq, m.ddq, s.dq_r, s.ddq_r, s.sign, s.load, s.temperature, s.time,
        s.states,
    ]  # fmt: skip
