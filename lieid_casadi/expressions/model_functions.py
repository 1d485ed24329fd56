"""The CasADi functions of a model, from which batches are compiled."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache

import casadi as ca
import numpy as np

from lieid_casadi.arrays import Array, Indices
from lieid_casadi.dynamics import closed_form, recursion
from lieid_casadi.dynamics.lie import Motion
from lieid_casadi.dynamics.regressor import regressor
from lieid_casadi.effects.effect import EffectSignals
from lieid_casadi.model import Model
from lieid_casadi.robot.robot import Robot

SIGNAL_NAMES = ("q", "dq", "ddq", "load", "temperature", "time", "command_error")


@dataclass(frozen=True)
class SparseFunction:
    """A function that returns the nonzeros (nnz,) at ``rows, columns`` of a matrix of ``shape``."""

    function: ca.Function
    rows: Indices
    columns: Indices
    shape: tuple[int, int]


def sparse_function(
    name: str, inputs: list[ca.SX], names: list[str], matrix: ca.SX
) -> SparseFunction:
    """Return a `SparseFunction` of an SX matrix and its inputs' names."""
    matrix = ca.sparsify(matrix)
    rows, columns = matrix.sparsity().get_triplet()
    nonzeros = ca.vec(matrix.nz[:])  # a column of a matrix with one row, too
    function = ca.Function(name, inputs, [ca.densify(nonzeros)], names, ["nonzeros"], {"cse": True})
    return SparseFunction(
        function, np.array(rows, dtype=np.intp), np.array(columns, dtype=np.intp), matrix.shape
    )


def column_function(function: ca.Function) -> SparseFunction:
    """Return a function of one column (s,) as a `SparseFunction`."""
    rows = np.arange(function.size1_out(0))
    return SparseFunction(function, rows, np.zeros_like(rows), (len(rows), 1))


def ramp(dq: ca.SX, width: ca.SX) -> ca.SX:
    """Return sgn(q̇); inside |q̇| ≤ width its expected value under noise on q̇.

    With Gaussian noise of a third of the width the sign is erf(3 q̇ / (√2 width)) on average;
    this is the polynomial step of degree seven, within 0.04 of it and cheap in C.
    """
    x = dq / ca.fmax(width, 1e-200)
    square = x * x
    step = x * (35.0 - square * (35.0 - square * (21.0 - 5.0 * square))) / 16.0
    return ca.if_else(ca.fabs(dq) < width, step, ca.sign(dq))


_symbols = lru_cache(maxsize=16)(Motion.symbols)  # which all models with n joints share


@lru_cache(maxsize=16)
def _rigid_regressor(robot: Robot) -> ca.SX:
    """Return the regressor (n, 10 n)."""
    return regressor(robot, _symbols(robot.n))


POSE, STATE = "q sin cos", "q sin cos dq ddq"  # inputs of rigid functions


class ModelFunctions:
    """Lazily built functions of one model, in (n,) columns; rigid ones take sin q and cos q."""

    def __init__(self, model: Model) -> None:
        self.model, n = model, model.n
        self.motion = _symbols(n)
        self.parameters = ca.SX.sym("parameters", 10 * n)
        self.shapes = ca.SX.sym("shapes", len(model.shapes))
        self.dead_zone = ca.SX.sym("dead_zone", n)
        self.load = ca.SX.sym("load", n)
        self.temperature = ca.SX.sym("temperature", n)
        self.time = ca.SX.sym("time")
        self.command_error = ca.SX.sym("command_error", n)
        self.states = ca.SX.sym("states", len(model.states))
        self.coefficients = ca.SX.sym("coefficients", len(model.columns))
        further = (*SIGNAL_NAMES[3:], "parameters", "shapes", "dead_zone", "states", "coefficients")
        self._symbols = vars(self.motion) | {name: getattr(self, name) for name in further}

    @cached_property
    def _rigid(self) -> ca.SX:
        return _rigid_regressor(self.model.robot)

    def _sparse(self, name: str, inputs: str, matrix: ca.SX) -> SparseFunction:
        names = inputs.split()
        return sparse_function(name, [self._symbols[x] for x in names], names, matrix)

    @cached_property
    def signals(self) -> EffectSignals:
        """Symbols of the effects; the sign of q̇ has a ramp over the dead zone."""
        return self._signals([self._symbols[name] for name in SIGNAL_NAMES])

    def _signals(self, symbols: Sequence[ca.SX]) -> EffectSignals:
        q, dq, ddq, load, temperature, time, error = symbols
        sign = ramp(dq, self.dead_zone)
        return EffectSignals(q, dq, ddq, sign, load, temperature, time, error)

    @cached_property
    def regressor(self) -> SparseFunction:
        """Y (n, 10 n)."""
        return self._sparse("regressor", STATE, self._rigid)

    @cached_property
    def base_regressor(self) -> SparseFunction:
        """Y_b (n, p): the rigid part of the kept columns; effect columns are zero here."""
        kept, n = self.model.base.kept, self.model.n
        rigid = self._rigid[:, [int(k) for k in kept[kept < 10 * n]]]
        zeros = ca.SX(n, len(kept) - rigid.size2())
        return self._sparse("base_regressor", STATE, ca.horzcat(rigid, zeros))

    @cached_property
    def _effects(self) -> tuple[str, ca.SX]:
        """Inputs and matrix (n, m) of the effects' columns."""
        inputs = " ".join([*SIGNAL_NAMES, "shapes dead_zone"])
        inputs += " states" if self.model.states else ""
        return inputs, self.model.effect_columns(self.signals, self.shapes, self.states)

    @cached_property
    def effect_columns(self) -> SparseFunction:
        """All effect columns (n, m); ``states`` (S,) is an input of effects that have memory."""
        return self._sparse("effect_columns", *self._effects)

    @cached_property
    def base_effects(self) -> SparseFunction:
        """The effect columns that the base regressor keeps (n, k)."""
        (inputs, matrix), kept = self._effects, self.model.base.kept - 10 * self.model.n
        return self._sparse("base_effects", inputs, matrix[:, [int(k) for k in kept[kept >= 0]]])

    @cached_property
    def effect_torque(self) -> SparseFunction:
        """Torque of all effects (n, 1), given their linear coefficients."""
        inputs, matrix = self._effects
        torque = ca.densify(ca.mtimes(matrix, self.coefficients))
        return self._sparse("effect_torque", f"{inputs} coefficients", torque)

    @cached_property
    def advance(self) -> ca.Function:
        """States (S,) at a sample, from its signals and the states and signals before it."""
        symbols = [self._symbols[name] for name in SIGNAL_NAMES]
        past = [
            ca.SX.sym(f"before_{name}", symbol.size1())
            for name, symbol in zip(SIGNAL_NAMES, symbols, strict=True)
        ]
        after = self.model.advance(self._signals(past), self.signals, self.shapes, self.states)
        inputs = [self.states, *past, *symbols, self.shapes, self.dead_zone]
        names = ["states", *(f"before_{name}" for name in SIGNAL_NAMES), *SIGNAL_NAMES]
        names += ["shapes", "dead_zone"]
        return ca.Function("advance", inputs, [ca.densify(after)], names, ["after"], {"cse": True})

    @cached_property
    def memory(self) -> SparseFunction:
        """`advance` as a column (S, 1)."""
        return column_function(self.advance)

    @cached_property
    def inverse_dynamics(self) -> SparseFunction:
        """Rigid torque (n, 1) of motion and link parameters."""
        torque = recursion.inverse_dynamics(self.model.robot, self.motion, self.parameters)
        return self._sparse("inverse_dynamics", f"{STATE} parameters", ca.densify(torque))

    @cached_property
    def mass_matrix(self) -> SparseFunction:
        """M (n, n)."""
        matrix = closed_form.mass_matrix(self.model.robot, self.motion, self.parameters)
        return self._sparse("mass_matrix", f"{POSE} parameters", matrix)

    @cached_property
    def gravity(self) -> SparseFunction:
        """G (n, 1)."""
        torque = closed_form.gravity(self.model.robot, self.motion, self.parameters)
        return self._sparse("gravity", f"{POSE} parameters", ca.densify(torque))

    @cached_property
    def jacobian(self) -> SparseFunction:
        """J (6, n) of the tool, [ω; v], base axes."""
        matrix = closed_form.jacobian(self.model.robot, self.motion)
        return self._sparse("jacobian", POSE, matrix)


def states_along(functions: ModelFunctions, signals: Mapping[str, Array]) -> Array:
    """Return the states (N, S) at every sample of one segment.

    The first sample has the initial states; each further one follows from the sample before it,
    whatever the time between them. States are held at samples that are not finite
    (`Effect.next_states`). ``signals``: q, dq, ddq, load (N, n) and time (N, 1), zero where they
    are left out; ``shapes`` (s,) and ``dead_zone`` (n,).
    """
    samples, model = len(signals["q"]), functions.model
    states = np.tile(model.initial_states, (samples, 1))
    if samples < 2:
        return states
    series = [_series(signals, name, samples, model.n) for name in SIGNAL_NAMES]
    constants = [
        np.repeat(np.reshape(signals[name], (-1, 1)), samples - 1, axis=1)
        for name in ("shapes", "dead_zone")
    ]
    steps = functions.advance.mapaccum("steps", samples - 1)
    ends = (*(x[:, :-1] for x in series), *(x[:, 1:] for x in series))
    states[1:] = steps(model.initial_states, *ends, *constants).full().T
    return states


def _series(signals: Mapping[str, Array], name: str, samples: int, n: int) -> Array:
    if name in signals:
        return np.reshape(signals[name], (samples, -1)).T
    return np.zeros((1 if name == "time" else n, samples))
