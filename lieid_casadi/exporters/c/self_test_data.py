"""Samples of a motion, and what CasADi computes there, for the self-test of exported C."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass

import casadi as ca
import numpy as np

from lieid_casadi.arrays import Array
from lieid_casadi.exporters.c.expressions import ExportExpressions, ExportSymbols, ModelNumbers
from lieid_casadi.exporters.c.functions import RIGID_ARGUMENTS, SAMPLE_ARGUMENTS, ExportForm
from lieid_casadi.identification.fit import Fit
from lieid_casadi.robot.inertia import parameter_transport

PACE = 2.0  # rad/s of the motion q = … cos(PACE·t): it reverses at t = 0, 1.57 and 3.14 s
TIMES = (0.0, 0.01, 0.02, 0.05, 0.1, 0.3, 0.8, 1.56, 1.58, 1.6, 2.2, 3.05, 3.15)  # s
_ALSO = {  # results that the test of a function needs besides its own
    "regressor": ("rigid_torque",),
    "friction": ("rigid_torque",),
    "torque": ("rigid_torque",),
    "effect_columns": ("rigid_torque", "friction"),
    "base_regressor": ("rigid_torque", "torque"),
    "forward_dynamics": ("rigid_torque", "torque"),
}
PAYLOAD = (0.3, 0.006, -0.009, 0.015, 2e-3, 3e-4, 2.5e-3, -2e-4, 1e-4, 1.8e-3)  # SI, of a test
SMOOTHING = 0.05  # v0, rad/s, of the smooth sign


@dataclass(frozen=True, eq=False)
class SelfTestData:
    """Samples of one motion (K, ·) and the results of each function (K, size).

    Results named ``…_smooth`` belong to the sign tanh(q̇/v0), v0 (n,); the others to the sharp one.
    ``acceleration_scale`` (n,) is what errors of forward dynamics are relative to.
    """

    inputs: dict[str, Array]
    v0: Array
    results: dict[str, Array]
    acceleration_scale: Array | None


@dataclass(frozen=True, eq=False)
class SelfTestNumbers:
    """Numbers with which the functions are called; others than the fit's where they are inputs."""

    link_parameters: Array
    effect_coefficients: Array
    shapes: Array
    payload: Array

    @classmethod
    def of(cls, fit: Fit, form: ExportForm) -> SelfTestNumbers:
        """Return the fit's numbers, changed where they are inputs."""
        links, coefficients, shapes = fit.link_parameters, fit.effect_coefficients, fit.shapes
        if "parameters" in form.runtime:
            links, coefficients, shapes = 1.1 * links, 0.9 * coefficients, 1.05 * shapes
        payload = np.array(PAYLOAD) if "payload" in form.runtime else np.zeros(10)
        return cls(*(form.precision.rounded(x) for x in (links, coefficients, shapes, payload)))

    def links(self, fit: Fit) -> Array:
        """Return link parameters (10 n,) with the payload."""
        made = self.link_parameters.copy()
        made[-10:] += parameter_transport(fit.model.robot.tool) @ self.payload
        return made


def self_test_data(fit: Fit, names: Collection[str], form: ExportForm) -> SelfTestData:
    """Evaluate the model, with numbers as inputs, along a motion through the joints' ranges.

    Joints start at rest, so that sgn(0) = 0 occurs. The torque of forward dynamics is that of the
    motion.

    ``names``: functions whose results are compared.
    """
    inputs = {name: form.precision.rounded(x) for name, x in _motion(fit).items()}
    v0 = form.precision.rounded(np.full(fit.model.n, SMOOTHING))
    wanted = {*names, *(further for name in names for further in _ALSO.get(name, ()))}
    machine = _Evaluator(fit, SelfTestNumbers.of(fit, form))
    results = machine.rigid(inputs, [name for name in RIGID_ARGUMENTS if name in wanted])
    effects = [name for name in SAMPLE_ARGUMENTS if name in wanted]
    if effects:
        inputs["load"] = form.precision.rounded(results["rigid_torque"])
        for ending, sign in (("", np.sign(inputs["dq"])), ("_smooth", np.tanh(inputs["dq"] / v0))):
            for name, values in machine.effects(inputs | {"sign": sign}, effects).items():
                results[name + ending] = values
    scale = None
    if "forward_dynamics" in effects:
        scale = machine.acceleration_scale(inputs, results["torque"])
    return SelfTestData(inputs, v0, results, scale)


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

    def __init__(self, fit: Fit, tested: SelfTestNumbers) -> None:
        self._fit, model = fit, fit.model
        self._now, self._before = ExportSymbols.of(fit), ExportSymbols.of(fit, "before_")
        links = ca.SX.sym("links", 10 * model.n)
        coefficients = ca.SX.sym("coefficients", len(model.columns))
        shapes = ca.SX.sym("shapes", len(model.shapes))
        numbers = ModelNumbers(links, links, coefficients, shapes, {})
        self._expressions = ExportExpressions(fit, self._now, numbers)
        self._arguments = [*_all(self._now), *_all(self._before), links, coefficients, shapes]
        self._numbers = [tested.links(fit), tested.effect_coefficients, tested.shapes]

    def rigid(self, inputs: dict[str, Array], names: Sequence[str]) -> dict[str, Array]:
        """Return results (K, size) of functions of the motion."""
        return {name: self._along(getattr(self._expressions, name), inputs) for name in names}

    def effects(self, inputs: dict[str, Array], names: Sequence[str]) -> dict[str, Array]:
        """Return results (K, size) of functions of a sample, and the states."""
        e, model, count = self._expressions, self._fit.model, len(inputs["q"])
        results: dict[str, Array] = {}
        if model.states:
            states = np.tile(model.initial_states, (count, 1))
            after = self._function(e.advance(self._before))
            for k in range(1, count):
                states[k] = self._at(after, inputs | {"states": states}, k, k - 1)
            results["states"] = states
            inputs = inputs | {"states": states}
        for name in names:  # the torque before forward dynamics, in the order of the functions
            results[name] = self._along(getattr(e, name), inputs | results)
        return results

    def acceleration_scale(self, inputs: dict[str, Array], torque: Array) -> Array:
        """Return Σ_j |M⁻¹|_ij·max|τ_j| (n,), the largest of the samples.

        A rounding error of the torques, relative to each one's size, changes the acceleration by
        this times the relative error.
        """
        n = self._fit.model.n
        mass = self._along(self._expressions.loaded_mass_matrix, inputs).reshape(-1, n, n)
        return np.asarray((np.abs(np.linalg.inv(mass)) @ np.abs(torque).max(axis=0)).max(axis=0))

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
            row.get("sign", zero), row.get("load", zero), row.get("torque", zero),
            row["temperature"] - mean,
            row["time"], row.get("states", np.zeros(len(model.states))),
        ]  # fmt: skip


def _all(symbols: ExportSymbols) -> list[ca.SX]:
    m, s = symbols.motion, symbols
    return [
        m.q, m.sin, m.cos, m.dq, m.ddq, s.dq_r, s.ddq_r, s.sign, s.load, s.torque,
        s.temperature, s.time, s.states,
    ]  # fmt: skip
