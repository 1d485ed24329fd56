"""The CasADi functions of a model, from which batches are compiled."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property, lru_cache

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from lieid_casadi.arrays import Array
from lieid_casadi.dynamics import closed_form, recursion
from lieid_casadi.dynamics.lie import Motion
from lieid_casadi.dynamics.regressor import regressor
from lieid_casadi.effects.effect import EffectSignals
from lieid_casadi.model import Model
from lieid_casadi.robot.robot import Robot

SIGNAL_NAMES = ("q", "dq", "ddq", "load", "temperature", "time", "command_error")
STEPS = 256  # samples per call of the unrolled step of states


@dataclass(frozen=True)
class SparseFunction:
    """A function whose matrix result is returned as its structural nonzeros (nnz,).

    ``function`` maps its inputs to the vector of nonzeros; entry k belongs to
    ``rows[k], columns[k]`` of a matrix of ``shape``.
    """

    function: ca.Function
    rows: NDArray[np.intp]
    columns: NDArray[np.intp]
    shape: tuple[int, int]


def sparse_function(
    name: str, inputs: list[ca.SX], names: list[str], matrix: ca.SX
) -> SparseFunction:
    """Return a `SparseFunction` of an SX matrix.

    ``names``: of the inputs.
    """
    matrix = ca.sparsify(matrix)
    rows, columns = matrix.sparsity().get_triplet()
    nonzeros = ca.vec(matrix.nz[:])  # a column of a matrix with one row, too
    function = ca.Function(name, inputs, [ca.densify(nonzeros)], names, ["nonzeros"], {"cse": True})
    return SparseFunction(
        function, np.array(rows, dtype=np.intp), np.array(columns, dtype=np.intp), matrix.shape
    )


def ramp(dq: ca.SX, width: ca.SX) -> ca.SX:
    """Return sgn(q̇); inside |q̇| ≤ width its expected value under noise on q̇.

    With Gaussian noise of a third of the width the sign is erf(3 q̇ / (√2 width)) on average;
    this is the polynomial step of degree seven, within 0.04 of it and cheap in C.
    """
    x = dq / ca.fmax(width, 1e-200)
    square = x * x
    step = x * (35.0 - square * (35.0 - square * (21.0 - 5.0 * square))) / 16.0
    return ca.if_else(ca.fabs(dq) < width, step, ca.sign(dq))


class _RigidRegressor:
    """The regressor of a robot (n, 10 n) in symbols that all its models share.

    It takes longer to build than the columns of all effects.
    """

    def __init__(self, robot: Robot) -> None:
        self._robot, self.motion = robot, Motion.symbols(robot.n)

    @cached_property
    def matrix(self) -> ca.SX:
        return regressor(self._robot, self.motion)


_rigid_regressor = lru_cache(maxsize=16)(_RigidRegressor)


class ModelFunctions:
    """Lazily built functions of one model; inputs are (n,) columns unless stated.

    Rigid functions take ``sin`` and ``cos`` of q beside q itself, so that generated code can
    compute them separately.
    """

    def __init__(self, model: Model) -> None:
        self.model = model
        n = model.n
        self._rigid = _rigid_regressor(model.robot)
        self.motion = self._rigid.motion
        self.parameters = ca.SX.sym("parameters", 10 * n)
        self.shapes = ca.SX.sym("shapes", len(model.shapes))
        self.dead_zone = ca.SX.sym("dead_zone", n)
        self.load = ca.SX.sym("load", n)
        self.temperature = ca.SX.sym("temperature", n)
        self.time = ca.SX.sym("time")
        self.command_error = ca.SX.sym("command_error", n)
        self.states = ca.SX.sym("states", len(model.states))

    @property
    def _state(self) -> tuple[list[ca.SX], list[str]]:
        m = self.motion
        return [m.q, m.sin, m.cos, m.dq, m.ddq], ["q", "sin", "cos", "dq", "ddq"]

    @property
    def _pose(self) -> tuple[list[ca.SX], list[str]]:
        m = self.motion
        return [m.q, m.sin, m.cos], ["q", "sin", "cos"]

    @cached_property
    def signals(self) -> EffectSignals:
        """Symbols of the effects; the sign of q̇ has a ramp over the dead zone."""
        m = self.motion
        sign = ramp(m.dq, self.dead_zone)
        return EffectSignals(
            m.q, m.dq, m.ddq, sign, self.load, self.temperature, self.time, self.command_error
        )

    @cached_property
    def regressor(self) -> SparseFunction:
        """Y (n, 10 n)."""
        inputs, names = self._state
        return sparse_function("regressor", inputs, names, self._rigid.matrix)

    @cached_property
    def base_regressor(self) -> SparseFunction:
        """Y_b (n, p): the rigid part of the kept columns; effect columns are zero here."""
        kept = self.model.base.kept
        rigid = [int(k) for k in kept[kept < 10 * self.model.n]]
        inputs, names = self._state
        matrix = ca.horzcat(
            self._rigid.matrix[:, rigid], ca.SX(self.model.n, len(kept) - len(rigid))
        )
        return sparse_function("base_regressor", inputs, names, matrix)

    @cached_property
    def effect_columns(self) -> SparseFunction:
        """All effect columns (n, m) as a function of motion, load, temperature, time and shapes.

        With effects that have memory, ``states`` (S,) is a further input.
        """
        s = self.signals
        inputs = [s.q, s.dq, s.ddq, s.load, s.temperature, s.time, self.command_error]
        inputs += [self.shapes, self.dead_zone]
        names = [*SIGNAL_NAMES, "shapes", "dead_zone"]
        if self.model.states:
            inputs, names = [*inputs, self.states], [*names, "states"]
        matrix = self.model.effect_columns(s, self.shapes, self.states)
        return sparse_function("effect_columns", inputs, names, matrix)

    @cached_property
    def advance(self) -> ca.Function:
        """States (S,) at a sample, from its signals and the states and signals before it."""
        now = self.signals
        symbols = [now.q, now.dq, now.ddq, now.load, now.temperature, now.time, self.command_error]
        past = [
            ca.SX.sym(f"before_{name}", symbol.size1())
            for name, symbol in zip(SIGNAL_NAMES, symbols, strict=True)
        ]
        q, dq, ddq, *others = past
        before = EffectSignals(q, dq, ddq, ramp(dq, self.dead_zone), *others)
        after = self.model.advance(before, now, self.shapes, self.states)
        inputs = [self.states, *past, *symbols, self.shapes, self.dead_zone]
        names = ["states", *(f"before_{name}" for name in SIGNAL_NAMES), *SIGNAL_NAMES]
        return ca.Function("advance", inputs, [after], [*names, "shapes", "dead_zone"], ["after"])

    @cached_property
    def steps(self) -> ca.Function:
        """`advance` over STEPS consecutive samples: inputs (·, STEPS), states (S, STEPS)."""
        return self.advance.mapaccum("steps", STEPS).expand()

    @cached_property
    def inverse_dynamics(self) -> SparseFunction:
        """Rigid torque (n, 1) of motion and link parameters."""
        inputs, names = self._state
        torque = recursion.inverse_dynamics(self.model.robot, self.motion, self.parameters)
        return sparse_function(
            "inverse_dynamics",
            [*inputs, self.parameters],
            [*names, "parameters"],
            ca.densify(torque),
        )

    @cached_property
    def mass_matrix(self) -> SparseFunction:
        """M (n, n)."""
        inputs, names = self._pose
        matrix = closed_form.mass_matrix(self.model.robot, self.motion, self.parameters)
        return sparse_function(
            "mass_matrix", [*inputs, self.parameters], [*names, "parameters"], matrix
        )

    @cached_property
    def gravity(self) -> SparseFunction:
        """G (n, 1)."""
        inputs, names = self._pose
        torque = closed_form.gravity(self.model.robot, self.motion, self.parameters)
        return sparse_function(
            "gravity", [*inputs, self.parameters], [*names, "parameters"], ca.densify(torque)
        )

    @cached_property
    def coriolis_matrix(self) -> SparseFunction:
        """C (n, n) with Ṁ − 2C skew-symmetric."""
        inputs, names = self._pose
        matrix = closed_form.coriolis_matrix(self.model.robot, self.motion, self.parameters)
        return sparse_function(
            "coriolis_matrix",
            [*inputs, self.motion.dq, self.parameters],
            [*names, "dq", "parameters"],
            matrix,
        )

    @cached_property
    def jacobian(self) -> SparseFunction:
        """J (6, n) of the tool, [ω; v], base axes."""
        inputs, names = self._pose
        matrix = closed_form.jacobian(self.model.robot, self.motion)
        return sparse_function("jacobian", inputs, names, matrix)


def states_along(functions: ModelFunctions, signals: Mapping[str, Array]) -> Array:
    """Return the states (N, S) at every sample of one segment.

    The first sample has the initial states; each further one follows from the sample before it,
    whatever the time between them. States are held at samples that are not finite
    (`Effect.next_states`).

    ``signals``: ``q`` and, where known, ``dq``, ``ddq``, ``load``, ``temperature`` (N, n) and
    ``time`` (N, 1); ``shapes`` (s,) and ``dead_zone`` (n,). Signals that are left out are zero.
    """
    samples, model = len(signals["q"]), functions.model
    states = np.empty((samples, len(model.states)))
    if not samples:
        return states
    states[0] = current = model.initial_states
    series = [_series(signals, name, samples, model.n) for name in SIGNAL_NAMES]
    constants = [
        np.repeat(np.reshape(signals[name], (-1, 1)), STEPS, axis=1)
        for name in ("shapes", "dead_zone")
    ]
    for first in range(0, samples - 1, STEPS):
        # the last chunk is filled with the last sample; the surplus results are discarded
        rows = np.minimum(np.arange(first, first + STEPS + 1), samples - 1)
        chunk = [x[:, rows] for x in series]
        result = functions.steps(
            current, *(x[:, :-1] for x in chunk), *(x[:, 1:] for x in chunk), *constants
        ).full()
        count = min(STEPS, samples - 1 - first)
        states[first + 1 : first + 1 + count] = result[:, :count].T
        current = result[:, count - 1]
    return states


def _series(signals: Mapping[str, Array], name: str, samples: int, n: int) -> Array:
    if name in signals:
        return np.reshape(signals[name], (samples, -1)).T
    return np.zeros((1 if name == "time" else n, samples))
