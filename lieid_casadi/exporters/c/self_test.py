"""The self-test of exported C: samples of a motion, and what CasADi computes there."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np

from lieid_casadi.arrays import Array
from lieid_casadi.exporters.c.expressions import ExportExpressions, SampleSymbols
from lieid_casadi.exporters.c.functions import (
    RIGID_ARGUMENTS,
    SAMPLE_ARGUMENTS,
    WITHOUT_NUMBERS,
)
from lieid_casadi.expressions.model_functions import ramp
from lieid_casadi.expressions.torque import Values
from lieid_casadi.identification.fit import Fit
from lieid_casadi.robot.inertia import parameter_transport

PACE = 2.0  # rad/s of the motion q = … cos(PACE·t): it reverses at t = 0, 1.57 and 3.14 s
TIMES = (0.0, 0.01, 0.02, 0.05, 0.1, 0.3, 0.8, 1.56, 1.58, 1.6, 2.2, 3.05, 3.15)  # s
_ALSO = {  # results that the test of a function needs besides its own
    "regressor": ("rigid_torque",),
    "friction": ("rigid_torque",),
    "effect_torque": ("rigid_torque",),
    "torque": ("rigid_torque",),
    "effect_columns": ("rigid_torque", "effect_torque"),
    "base_regressor": ("rigid_torque", "torque"),
    "forward_dynamics": ("rigid_torque", "torque"),
}
PAYLOAD = (0.3, 0.006, -0.009, 0.015, 2e-3, 3e-4, 2.5e-3, -2e-4, 1e-4, 1.8e-3)  # SI, of a test
SMOOTHING = 0.1  # rad/s, half width of the smooth sign


@dataclass(frozen=True, eq=False)
class SelfTestData:
    """Samples of one motion (K, ·) and the results of each function (K, size).

    Results named ``…_smooth`` belong to the sign that is smooth in ``smooth_velocity`` (n,).
    ``acceleration_scale`` (n,) is what errors of forward dynamics are relative to.
    """

    inputs: dict[str, Array]
    smooth_velocity: Array
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
    def of(cls, fit: Fit, runtime: Sequence[str]) -> SelfTestNumbers:
        """Return the fit's numbers, changed where they are inputs."""
        links, coefficients, shapes = fit.link_parameters, fit.effect_coefficients, fit.shapes
        if "parameters" in runtime:
            links, coefficients, shapes = 1.1 * links, 0.9 * coefficients, 1.05 * shapes
        payload = np.array(PAYLOAD) if "payload" in runtime else np.zeros(10)
        return cls(links, coefficients, shapes, payload)

    def links(self, fit: Fit) -> Array:
        """Return link parameters (10 n,) with the payload."""
        made = self.link_parameters.copy()
        made[-10:] += parameter_transport(fit.model.robot.tool) @ self.payload
        return made


def self_test_data(fit: Fit, names: Collection[str], runtime: Sequence[str]) -> SelfTestData:
    """Evaluate functions, with numbers as inputs, along a motion through the joints' ranges.

    Joints start at rest, so that sgn(0) = 0 occurs. The torque of forward dynamics is that of the
    motion.
    """
    inputs, width = _motion(fit), np.full(fit.model.n, SMOOTHING)
    wanted = {*names, *(further for name in names for further in _ALSO.get(name, ()))}
    machine = _Evaluator(fit, SelfTestNumbers.of(fit, runtime))
    results = machine.rigid(inputs, [name for name in RIGID_ARGUMENTS if name in wanted])
    effects = [name for name in SAMPLE_ARGUMENTS if name in wanted]
    if effects:
        inputs["load"] = results["rigid_torque"]
        for ending, sign in (
            ("", np.sign(inputs["dq"])),
            ("_smooth", _smooth(inputs["dq"], width)),
        ):
            for name, values in machine.effects(inputs | {"sign": sign}, effects).items():
                results[name + ending] = values
    scale = None
    if "forward_dynamics" in effects:
        scale = machine.acceleration_scale(inputs, results["torque"])
    return SelfTestData(inputs, width, results, scale)


def _smooth(dq: Array, width: Array) -> Array:
    symbols = [ca.SX.sym("dq", len(width)), ca.SX.sym("width", len(width))]
    sign = ca.Function("sign", symbols, [ramp(*symbols)])
    return np.asarray(sign(dq.T, width).full().T)


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
        self._model, self._mean = fit.model, fit.temperature_mean
        e = self._expressions = ExportExpressions(fit, Values.symbols(fit.model))
        self._before = before = SampleSymbols.before(fit.model.n)
        self._numbers = [tested.links(fit), tested.effect_coefficients, tested.shapes]
        values = [e.values.parameters, e.values.effects, e.values.shapes]
        self._arguments = [
            *_of_sample(e), e.dq_r, e.ddq_r, e.tau, e.states, *_of_sample(before), *values,
        ]  # fmt: skip

    def rigid(self, inputs: dict[str, Array], names: Sequence[str]) -> dict[str, Array]:
        """Return results (K, size) of functions of the motion."""
        return {name: self._along(getattr(self._expressions, name), inputs) for name in names}

    def effects(self, inputs: dict[str, Array], names: Sequence[str]) -> dict[str, Array]:
        """Return results (K, size) of functions of a sample, and the states."""
        e, results = self._expressions, dict[str, Array]()
        if self._model.states:
            states = np.tile(self._model.initial_states, (len(inputs["q"]), 1))
            after = e.advance(self._before)
            for k in range(1, len(states)):
                now, last = slice(k, k + 1), slice(k - 1, k)
                here = {name: values[now] for name, values in inputs.items()}
                past = {name: values[last] for name, values in inputs.items()}
                states[k] = self._along(after, here | {"states": states[last]}, past)[0]
            results["states"] = states
        for name in names:  # the torque before forward dynamics, in the order of the functions
            results[name] = self._along(getattr(e, name), inputs | results)
        return results

    def acceleration_scale(self, inputs: dict[str, Array], torque: Array) -> Array:
        """Return Σ_j |M⁻¹|_ij·max|τ_j| (n,), the largest of the samples.

        A rounding error of the torques, relative to each one's size, changes the acceleration by
        this times the relative error.
        """
        n = self._model.n
        mass = self._along(self._expressions.mass_matrix, inputs).reshape(-1, n, n)
        return np.asarray((np.abs(np.linalg.inv(mass)) @ np.abs(torque).max(axis=0)).max(axis=0))

    def _along(
        self, matrix: ca.SX, now: dict[str, Array], before: dict[str, Array] | None = None
    ) -> Array:
        """Return a matrix, row after row, at every sample (K, rows · columns)."""
        function = ca.Function("f", self._arguments, [ca.densify(ca.vec(matrix.T))])
        zero = np.zeros_like(now["q"])
        further = [now["dq_r"], now["ddq_r"], now.get("torque", zero)]
        further.append(now.get("states", np.zeros((len(zero), len(self._model.states)))))
        given = [*self._sample(now), *further, *self._sample(before or now)]
        return np.array(function(*(x.T for x in given), *self._numbers)).T

    def _sample(self, x: dict[str, Array]) -> list[Array]:
        """Return the values of `_of_sample` at every sample."""
        q, zero = x["q"], np.zeros_like(x["q"])
        mean = 0.0 if self._mean is None else self._mean
        return [
            q, np.sin(q), np.cos(q), x["dq"], x["ddq"], x.get("sign", zero), x.get("load", zero),
            x["temperature"] - mean, x["time"],
        ]  # fmt: skip


def _of_sample(x: ExportExpressions | SampleSymbols) -> list[ca.SX]:
    m = x.motion
    return [m.q, m.sin, m.cos, m.dq, m.ddq, x.sign, x.load, x.temperature, x.time]


def self_test_content(fit: Fit, names: Collection[str], runtime: Sequence[str]) -> dict[str, Any]:
    """Return the variables of the template of the self-test of exported functions."""
    tested = SelfTestNumbers.of(fit, runtime)
    stored = self_test_data(fit, names, runtime)
    rigid = [name for name in RIGID_ARGUMENTS if name in names]
    calls = [name for name in SAMPLE_ARGUMENTS if name in names]
    results = _compared(stored.results, names, calls)
    parameters = _identified(fit)
    arrays = _inputs_read(stored, rigid, calls)
    arrays += [(name, values.ravel()) for name, values in results.items()]
    arrays += list(parameters.items())
    if runtime:
        arrays += _factors(fit, tested, names)
    if stored.acceleration_scale is not None:
        arrays.append(("acceleration_scale", stored.acceleration_scale))
    sizes = {name: values.shape[1] for name, values in results.items()}
    products = {"effect_columns", "base_regressor"} & set(names)
    reports = [
        "begin", *(["states", "held_states"] if "states" in results else []),
        *calls, *(["products"] if products else []),
    ]  # fmt: skip
    return {
        "samples": len(stored.inputs["q"]),
        "largest": max(fit.model.n, *sizes.values()),
        "arrays": arrays,
        "parameters": [(name, len(values)) for name, values in parameters.items()],
        "rigid_calls": [
            (name, RIGID_ARGUMENTS[name], sizes[name], name not in WITHOUT_NUMBERS)
            for name in rigid
        ],
        "own": "tested" if runtime else None,
        "numbers_given": _numbers_given(tested, runtime),
        "effect_calls": [(name, SAMPLE_ARGUMENTS[name], sizes[name]) for name in calls],
        "multiplies": bool(products) or "regressor" in names,
        "signs": [("", "NULL"), ("_smooth", "smooth_velocity")] if calls else [],
        "reports": reports,
        "worsts": ", ".join(f"of_{name} = 0.0" for name in reports),
    }


def _compared(
    results: dict[str, Array], names: Collection[str], calls: Sequence[str]
) -> dict[str, Array]:
    """Return the results that the C code reads: without a rigid torque that nothing needs."""
    loaded = any(SAMPLE_ARGUMENTS[name] == "load" for name in calls)
    if loaded or {"rigid_torque", "regressor"} & set(names):
        return results
    return {name: values for name, values in results.items() if name != "rigid_torque"}


def _identified(fit: Fit) -> dict[str, Array]:
    """Return the identified numbers; those of which the model has none are left out."""
    numbers = {
        "link_parameters": fit.link_parameters,
        "base_parameters": fit.values,
        "effect_coefficients": fit.effect_coefficients,
        "shapes": fit.shapes,
    }
    return {name: values for name, values in numbers.items() if len(values)}


def _inputs_read(
    stored: SelfTestData, rigid: Sequence[str], calls: Sequence[str]
) -> list[tuple[str, Array]]:
    """Return the inputs that the tested functions read, by their names in C."""
    read = {name for function in rigid for name in RIGID_ARGUMENTS[function]}
    if calls:
        read |= {"q", "dq", "ddq", "temperature", "time"}
    # "time" is a function of C
    arrays = [
        (f"{name}_" if name == "time" else name, values.ravel())
        for name, values in stored.inputs.items()
        if name in read
    ]
    return [*arrays, ("smooth_velocity", stored.smooth_velocity)] if calls else arrays


def _factors(fit: Fit, tested: SelfTestNumbers, names: Collection[str]) -> list[tuple[str, Array]]:
    """Return what each exported matrix is multiplied by, where numbers are inputs."""
    links = tested.links(fit)
    every = np.concatenate([links, tested.effect_coefficients])
    factors = {
        "regressor": ("tested_link_parameters", links),
        "base_regressor": ("tested_base_parameters", fit.model.base.combination @ every),
        "effect_columns": ("tested_effect_coefficients", tested.effect_coefficients),
    }
    return [factor for name, factor in factors.items() if name in names]


def _numbers_given(tested: SelfTestNumbers, runtime: Sequence[str]) -> list[tuple[str, Array]]:
    """Return the numbers that are inputs of the exported functions."""
    return [
        (name, getattr(tested, name))
        for name in ("link_parameters", "effect_coefficients", "shapes", "payload")
        if len(getattr(tested, name))
        and ("payload" if name == "payload" else "parameters") in runtime
    ]
