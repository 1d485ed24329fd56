"""The self-test of exported C: samples of a motion, and what CasADi computes there."""

from __future__ import annotations

from collections.abc import Collection
from typing import Any

import casadi as ca
import numpy as np

from lieid_casadi.arrays import Array
from lieid_casadi.exporters.c.functions import (
    RIGID_ARGUMENTS,
    SAMPLE_ARGUMENTS,
    WITHOUT_NUMBERS,
    ExportExpressions,
    signal_inputs,
)
from lieid_casadi.expressions.effect_function import sign_of
from lieid_casadi.expressions.torque import Values
from lieid_casadi.identification.fit import Fit
from lieid_casadi.robot.inertia import parameter_transport

PACE = 2.0  # rad/s of the motion q = … cos(PACE·t): it reverses at t = 0, 1.57 and 3.14 s
TIMES = (0.0, 0.01, 0.02, 0.05, 0.1, 0.3, 0.8, 1.56, 1.58, 1.6, 2.2, 3.05, 3.15)  # s
PAYLOAD = (0.3, 0.006, -0.009, 0.015, 2e-3, 3e-4, 2.5e-3, -2e-4, 1e-4, 1.8e-3)  # SI, of a test
SMOOTHING = 0.1  # rad/s, half width of the smooth sign


def self_test_content(fit: Fit, names: Collection[str], *, payload: bool) -> dict[str, Any]:
    """Return the variables of the template of the self-test of exported functions.

    Joints start at rest, so that sgn(0) = 0 occurs. The torque of forward dynamics is that of the
    motion, with the sign. Results that end in ``_smooth`` belong to the smooth sign.
    """
    body = np.array(PAYLOAD) if payload else np.zeros(10)
    inputs, width = _motion(fit), np.full(fit.model.n, SMOOTHING)
    machine = _Evaluator(fit, body)
    calls = [name for name in SAMPLE_ARGUMENTS if name in names]
    results = {name: machine.along(name, inputs) for name in RIGID_ARGUMENTS}
    inputs["load"] = results["rigid_torque"]
    signs = {"": np.sign(inputs["dq"]), "_smooth": sign_of(inputs["dq"], width)}
    for ending, sign in signs.items():
        signed = machine.with_states(inputs | {"sign": sign})
        if not ending:
            inputs["torque"] = signed["torque"] = machine.along("torque", signed)
        if "states" in signed:
            results["states" + ending] = signed["states"]
        for name in calls:
            results[name + ending] = machine.along(name, signed)
    arrays = {"smooth_velocity": width}
    if "forward_dynamics" in calls:
        arrays["acceleration_scale"] = machine.acceleration_scale(inputs)
    else:
        del inputs["torque"]
    constants = {
        "link_parameters": fit.link_parameters,
        "base_parameters": fit.values,
        "effect_coefficients": fit.effect_coefficients,
        "shapes": fit.shapes,
    }
    arrays |= {f"in_{name}": values for name, values in inputs.items()}
    arrays |= {f"expected_{name}": values for name, values in results.items()}
    arrays |= {f"stored_{name}": values for name, values in constants.items() if len(values)}
    sizes = {name: values.shape[1] for name, values in results.items()}
    return {
        "samples": len(TIMES),
        "largest": max(fit.model.n, *sizes.values()),
        "arrays": [(name, values.ravel()) for name, values in arrays.items()],
        "constants": [(name, len(values)) for name, values in constants.items() if len(values)],
        "tested_payload": body,
        "rigid_calls": [
            (name, arguments, sizes[name], name not in WITHOUT_NUMBERS)
            for name, arguments in RIGID_ARGUMENTS.items()
        ],
        "effect_calls": [(name, SAMPLE_ARGUMENTS[name], sizes[name]) for name in calls],
        "signs": [("", "NULL"), ("_smooth", "smooth_velocity")],
        "reports": [*(["states"] if "states" in results else []), *calls],
    }


def _motion(fit: Fit) -> dict[str, Array]:
    """Return samples (K, ·) of a motion through the joints' ranges."""
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
    """Evaluation of the functions of a fit by CasADi, with its numbers and a payload as inputs."""

    def __init__(self, fit: Fit, payload: Array) -> None:
        e = self._expressions = ExportExpressions(fit, Values.symbols(fit.model))
        self._before = before = ExportExpressions(fit, e.values)
        self._symbols = {"dq_r": e.dq_r, "ddq_r": e.ddq_r, "torque": e.tau, "states": e.states}
        self._symbols |= {"load": e.load, "before_load": before.load}
        for prefix, x in (("", e), ("before_", before)):
            inputs = signal_inputs(fit, x, of="")
            self._symbols |= {prefix + name: given.symbol for name, given in inputs.items()}
        self._values = [e.values.parameters, e.values.effects, e.values.shapes]
        links = fit.link_parameters.copy()
        links[-10:] += parameter_transport(fit.model.robot.tool) @ payload
        self._numbers = [links, fit.effect_coefficients, fit.shapes]
        self._mean = 0.0 if fit.temperature_mean is None else fit.temperature_mean

    def along(self, name: str, inputs: dict[str, Array]) -> Array:
        """Return a matrix, row after row, at every sample (K, rows · columns)."""
        return self._at(getattr(self._expressions, name), self._given(inputs))

    def with_states(self, inputs: dict[str, Array]) -> dict[str, Array]:
        """Return inputs with the states of effects with memory, if the model has any."""
        model = self._expressions.model
        if not model.states:
            return inputs
        states = np.tile(model.initial_states, (len(TIMES), 1))
        after, given = self._expressions.advance(self._before), self._given(inputs)
        for k in range(1, len(states)):
            now = {name: x[k : k + 1] for name, x in given.items()}
            past = {f"before_{name}": x[k - 1 : k] for name, x in given.items()}
            states[k] = self._at(after, now | past | {"states": states[k - 1 : k]})[0]
        return inputs | {"states": states}

    def acceleration_scale(self, inputs: dict[str, Array]) -> Array:
        """Return Σ_j |M⁻¹|_ij·max|τ_j| (n,), the largest of the samples.

        A rounding error of the torques, relative to each one's size, changes the acceleration by
        this times the relative error.
        """
        n, torque = self._expressions.model.n, inputs["torque"]
        mass = self.along("mass_matrix", inputs).reshape(-1, n, n)
        return np.asarray((np.abs(np.linalg.inv(mass)) @ np.abs(torque).max(axis=0)).max(axis=0))

    def _given(self, inputs: dict[str, Array]) -> dict[str, Array]:
        q, temperature = inputs["q"], inputs["temperature"] - self._mean
        return inputs | {"sin": np.sin(q), "cos": np.cos(q), "temperature": temperature}

    def _at(self, matrix: ca.SX, given: dict[str, Array]) -> Array:
        symbols, samples = self._symbols, len(given["q"])
        function = ca.Function(
            "f", [*symbols.values(), *self._values], [ca.densify(ca.vec(matrix.T))]
        )
        zeros = {name: np.zeros((samples, x.size1())) for name, x in symbols.items()}
        arguments = [given.get(name, zero).T for name, zero in zeros.items()]
        return np.array(function(*arguments, *self._numbers)).T
