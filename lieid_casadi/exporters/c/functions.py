"""The functions that exported C may have, and their bodies as statements of plain C99.

They are dynamics of a fitted model with the identified numbers as constants.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import casadi as ca
import numpy as np

from lieid_casadi.arrays import Array
from lieid_casadi.dynamics import closed_form, recursion
from lieid_casadi.dynamics.base_parameters import base_parameters
from lieid_casadi.dynamics.lie import Motion
from lieid_casadi.dynamics.regressor import regressor, slotine_li_regressor
from lieid_casadi.effects import ArmEffect
from lieid_casadi.errors import ExportError
from lieid_casadi.expressions import forward_dynamics
from lieid_casadi.expressions.c_writer import ARITHMETIC, Dialect, UnsupportedOperation, statements
from lieid_casadi.expressions.forward_dynamics import obstacle
from lieid_casadi.expressions.model_functions import sparse_function
from lieid_casadi.expressions.symbolic import homogeneous
from lieid_casadi.expressions.torque import TorqueExpressions, Values
from lieid_casadi.identification.fit import Fit

AGREEMENT = 1e-13  # of the torque with fewer parameters, relative; the self-test requires 1e-12


class ExportExpressions(TorqueExpressions):
    """The torque of a model and its parts, and what controllers need besides."""

    def __init__(self, fit: Fit, values: Values, *, payload: bool = False) -> None:
        n = fit.model.n
        self.sign, self.dq_r, self.ddq_r = (ca.SX.sym(x, n) for x in ("sign", "dq_r", "ddq_r"))
        super().__init__(
            fit.model, values, None, as_measured=False, payload=payload, sign=self.sign,
            motion=Motion.symbols(n),
        )  # fmt: skip

    @cached_property
    def forward_kinematics(self) -> ca.SX:
        """Pose (4, 4) of the tool in the base frame."""
        return homogeneous(recursion.tool_in_base(self.model.robot, self.motion))

    @cached_property
    def jacobian(self) -> ca.SX:
        """J (6, n) of the tool: [ω; v] in axes of the base."""
        return closed_form.jacobian(self.model.robot, self.motion)

    @cached_property
    def regressor(self) -> ca.SX:
        """Y (n, 10 n)."""
        return regressor(self.model.robot, self.motion)

    @cached_property
    def slotine_li_regressor(self) -> ca.SX:
        """Y(q, q̇, q̇_r, q̈_r) (n, 10 n)."""
        reference = recursion.ReferenceMotion(self.dq_r, self.ddq_r)
        return slotine_li_regressor(self.model.robot, self.motion, reference)

    @cached_property
    def effect_columns(self) -> ca.SX:
        """Columns (n, m) of all effects, those on the measurement included."""
        columns = ca.SX(self.joint_columns)
        for slot in self.model.slots:
            p, own = slot.placement, slot.columns
            if isinstance(p.effect, ArmEffect):
                now = p.effect.instant_columns(self._instant, p.joint, self.values.effects[own])
                if now is None:
                    raise ExportError(
                        f"{p.label} needs the motion over time, and exported C has one instant; "
                        "expected a fit without this effect"
                    )
                columns[:, own] = now
        return columns

    @cached_property
    def base_regressor(self) -> ca.SX:
        """Y_b (n, p), effects included."""
        kept = [int(k) for k in self.model.base.kept]
        return ca.horzcat(self.regressor, self.effect_columns)[:, kept]

    @cached_property
    def effect_torque(self) -> ca.SX:
        """Torque of all effects (n,)."""
        return ca.mtimes(self.effect_columns, self.values.effects)

    @cached_property
    def torque(self) -> ca.SX:
        """Rigid torque and effects (n,), the load being that rigid torque."""
        load = ca.densify(self.rigid_torque)
        return self.rigid_torque + ca.substitute(self.effect_torque, self.load, load)

    @cached_property
    def forward_dynamics(self) -> ca.SX:
        """q̈ (n,) for the torque that the drives deliver."""
        return forward_dynamics.acceleration(self)

    def advance(self, before: ExportExpressions) -> ca.SX:
        """Return the states (S,) at this sample from those at the sample before."""
        signals = before._signals, self._signals
        return self.model.advance(*signals, self.values.shapes, self.states)


def export_expressions(fit: Fit, *, payload: bool = False) -> ExportExpressions:
    """Return expressions of the identified numbers; ``payload``: with a body as input."""
    # in another direction of gravity than the robot's, more link parameters have an effect
    whole = any(isinstance(p.effect, ArmEffect) for p in fit.model.placements)
    links = fit.link_parameters if whole else fewer_parameters(fit)
    numbers = Values.numbers(links, fit.effect_coefficients, fit.shapes)
    return ExportExpressions(fit, numbers, payload=payload)


def fewer_parameters(fit: Fit) -> Array:
    """Return link parameters (10 n,) with the same torque and as many zeros as possible.

    Only the parameters that head a rigid base parameter are not zero. If rounding in the geometry
    of the robot would change the torque, the link parameters of the fit are returned.
    """
    robot, links = fit.model.robot, fit.link_parameters
    base = base_parameters(robot)
    fewer = np.zeros_like(links)
    fewer[base.kept] = base.combination @ links
    motion = Motion.symbols(robot.n)
    y = ca.Function("y", list(vars(motion).values()), [ca.densify(regressor(robot, motion))])
    random = np.random.default_rng(0)
    for _ in range(20):
        q, dq, ddq = random.uniform(-3.0, 3.0, (3, robot.n))
        matrix = np.array(y(q, np.sin(q), np.cos(q), dq, ddq))
        size = np.abs(matrix @ links).max()
        if np.abs(matrix @ (links - fewer)).max() > AGREEMENT * size:
            return links
    return fewer


_CONDITIONS = {
    "LT": "{0} < {1} ? 1.0 : 0.0", "LE": "{0} <= {1} ? 1.0 : 0.0",
    "EQ": "{0} == {1} ? 1.0 : 0.0", "NE": "{0} != {1} ? 1.0 : 0.0",
    "NOT": "{0} == 0.0 ? 1.0 : 0.0",
    "AND": "{0} != 0.0 && {1} != 0.0 ? 1.0 : 0.0", "OR": "{0} != 0.0 || {1} != 0.0 ? 1.0 : 0.0",
    "IF_ELSE_ZERO": "{0} != 0.0 ? {1} : 0.0",
}  # fmt: skip
_LIBRARY = ("SIN", "COS", "EXP", "TANH", "SQRT", "FABS")  # all that is used of libm
_RUNTIME = (  # codegen/export/lieid_runtime.h
    "SIGN", "EXPM1", "LOG", "LOG1P", "TAN", "SINH", "COSH", "ASIN", "ACOS", "ATAN", "FLOOR",
    "CEIL",
)  # fmt: skip
_RUNTIME_OF_TWO = ("FMIN", "FMAX", "COPYSIGN", "ATAN2", "HYPOT")


TOLERANCE = 1e-12  # error that the self-test accepts, relative to the size of each result


def number(value: float) -> str:
    """Return a finite number as C reads it back, bit by bit."""
    if not math.isfinite(value):
        raise ExportError(f"the fit has a number that is {value}; expected finite ones")
    text = repr(float(value))
    return f"({text})" if text.startswith("-") else text


_FUNCTIONS = {name: f"{name.lower()}({{0}})" for name in _LIBRARY}
_FUNCTIONS |= {name: f"lieid_{name.lower()}({{0}})" for name in _RUNTIME}
_FUNCTIONS |= {name: f"lieid_{name.lower()}({{0}}, {{1}})" for name in _RUNTIME_OF_TWO}
DIALECT = Dialect("const double", ARITHMETIC | _CONDITIONS | _FUNCTIONS, number)
INDENT = "    "
ZEROS_PER_LINE = 5


@dataclass(frozen=True)
class FunctionInput:
    """A vector of symbols and the C expression of each of its elements."""

    symbol: ca.SX
    texts: tuple[str, ...]


def each(symbol: ca.SX, pattern: str) -> FunctionInput:
    """Return an input whose element j is a pattern with ``{j}`` filled in."""
    return FunctionInput(symbol, tuple(pattern.format(j=j) for j in range(symbol.size1())))


@dataclass(frozen=True)
class FunctionBody:
    """The body of a C function that writes a matrix, row after row."""

    lines: tuple[str, ...]
    used: frozenset[str]
    operations: int

    @property
    def text(self) -> str:
        """The lines, indented."""
        return "\n".join(INDENT + line for line in self.lines)


def body(
    matrix: ca.SX, inputs: Mapping[str, FunctionInput], *, to: str, arguments: Sequence[str] = ()
) -> FunctionBody:
    """Return the C statements that evaluate a matrix and write it, zeros too, to an array.

    ``inputs`` are the symbols by local name; ``arguments`` the names of the C function's arguments,
    of which those that the inputs do not need are marked as unused.
    """
    names = list(inputs)
    symbols = [given.symbol for given in inputs.values()]
    sparse = sparse_function("exported", symbols, [f"{name}_" for name in names], matrix)
    columns = matrix.shape[1]
    places = [int(i) * columns + int(j) for i, j in zip(sparse.rows, sparse.columns, strict=True)]

    def read(argument: int, j: int) -> tuple[str, str]:
        name = names[argument]
        return f"{name}_{j}", inputs[name].texts[j]

    def write(nonzero: int, value: str) -> str:
        return f"{to}[{places[nonzero]}] = {value};"

    try:
        written = statements(sparse.function, DIALECT, read=read, write=write)
    except UnsupportedOperation as error:
        raise ExportError(
            f"an effect uses CasADi's operation {error.operation}, which exported C does not have; "
            "expected arithmetic, comparisons, powers, exponential, trigonometric and hyperbolic "
            "functions"
        ) from None
    by_joint = sorted(written.inputs, key=lambda x: (x.index, x.argument))
    loads = [f"{DIALECT.declaration} {x.name} = {x.text};" for x in by_joint]
    read_names = set(re.findall(r"\w+", " ".join(x.text for x in by_joint)))
    unused = [f"(void){name};" for name in arguments if name not in read_names]
    zeros = _zeros(to, matrix.shape[0] * columns, places)
    used = frozenset(names[x.argument] for x in written.inputs)
    return FunctionBody((*unused, *loads, *zeros, *written.lines), used, written.operations)


def _zeros(to: str, size: int, places: Sequence[int]) -> list[str]:
    """Return statements that write the structural zeros.

    Not as loops: compilers make `memset` or ``rep stos`` of them, which start so slowly that they
    take twice the time of computing a regressor.
    """
    zeros = sorted(set(range(size)) - set(places))
    return [
        "".join(f"{to}[{k}] = " for k in zeros[first : first + ZEROS_PER_LINE]) + "0.0;"
        for first in range(0, len(zeros), ZEROS_PER_LINE)
    ]


RIGID_ARGUMENTS = {  # function: its arguments before the result
    "rigid_torque": ("q", "dq", "ddq"),
    "gravity": ("q",),
    "mass_matrix": ("q",),
    "link_mass_matrix": ("q",),
    "coriolis": ("q", "dq"),
    "forward_kinematics": ("q",),
    "jacobian": ("q",),
    "regressor": ("q", "dq", "ddq"),
    "slotine_li_regressor": ("q", "dq", "dq_r", "ddq_r"),
}
SAMPLE_ARGUMENTS = {  # function: its argument between the sample and the state
    "friction": "load",
    "effect_torque": "load",
    "torque": "",
    "forward_dynamics": "torque",
    "effect_columns": "load",
    "base_regressor": "load",
}
NAMES = (*RIGID_ARGUMENTS, *SAMPLE_ARGUMENTS)
WITHOUT_NUMBERS = ("forward_kinematics", "jacobian", "regressor", "slotine_li_regressor")
PAYLOAD_TEXT = "numbers->payload[{j}]"
_RESULTS = {  # name of the result, where it is no matrix
    "rigid_torque": "torque",
    "gravity": "torque",
    "forward_kinematics": "pose",
    "friction": "torque",
    "effect_torque": "torque",
    "torque": "torque",
    "forward_dynamics": "acceleration",
}


@dataclass(frozen=True, eq=False)
class ExportedFunctions:
    """Bodies of the C functions by name, and what the states of effects depend on."""

    bodies: dict[str, FunctionBody]
    advance: FunctionBody | None
    remembers_load: bool
    advance_reads_load: bool


def available(fit: Fit) -> tuple[list[str], list[str]]:
    """Return the names of the functions that a fit has, in the order of `NAMES`, and notes."""
    missing = _no_forward_dynamics(fit)
    notes = [f"{name} is left out: {reason}" for name, reason in missing.items()]
    if not fit.model.columns:
        missing["effect_columns"] = "the fit has no effects"
    return [name for name in NAMES if name not in missing], notes


def _no_forward_dynamics(fit: Fit) -> dict[str, str]:
    """Return why the fit has no forward dynamics, by the name of the function; empty if it has."""
    values = Values.numbers(fit.link_parameters, fit.effect_coefficients, fit.shapes)
    torque = TorqueExpressions(fit.model, values, None, as_measured=False, payload=False)
    reason = obstacle(
        torque, remedy="lieid identify --method feasible gives a fit whose mass matrix is"
    )
    return {"forward_dynamics": reason} if reason else {}


def exported_functions(
    fit: Fit, names: Sequence[str], *, payload: bool = False
) -> ExportedFunctions:
    """Return the C of functions; with ``payload`` a body at the tool is an argument."""
    made = export_expressions(fit, payload=payload)
    numbers = {} if made.payload is None else {"payload": each(made.payload, PAYLOAD_TEXT)}
    references = {"dq_r": each(made.dq_r, "dq_r[{j}]"), "ddq_r": each(made.ddq_r, "ddq_r[{j}]")}
    rigid = _motion_inputs(made.motion) | numbers | references
    sample = _sample_inputs(fit, made) | numbers
    further = {
        "": {},
        "load": {"load": each(made.load, "load[{j}]")},
        "torque": {"torque": each(made.tau, "torque[{j}]")},
    }
    advance = _advance(fit, made, numbers) if fit.model.states else None
    remembers = advance is not None and "before_load" in advance.used
    reads = remembers or (advance is not None and "load" in advance.used)
    bodies = {}
    for name in names:
        inputs = rigid if name in RIGID_ARGUMENTS else sample | further[SAMPLE_ARGUMENTS[name]]
        arguments = _arguments(name, payload)
        to = _RESULTS.get(name, "matrix")
        bodies[name] = body(getattr(made, name), inputs, to=to, arguments=arguments)
    return ExportedFunctions(bodies, advance, remembers, reads)


def _arguments(name: str, payload: bool) -> list[str]:
    """Return the names of a C function's arguments."""
    numbers = ["numbers"] if payload and name not in WITHOUT_NUMBERS else []
    if name in RIGID_ARGUMENTS:
        return [*RIGID_ARGUMENTS[name], *numbers]
    given = [SAMPLE_ARGUMENTS[name]] if SAMPLE_ARGUMENTS[name] else []
    return ["sample", *given, "state", "smooth_velocity", *numbers]


def _advance(fit: Fit, made: ExportExpressions, numbers: dict[str, FunctionInput]) -> FunctionBody:
    """Return the body that computes the states at a sample from those at the sample before."""
    before = ExportExpressions(fit, made.values)
    past = signal_inputs(fit, before, of="state->before.")
    past["load"] = each(before.load, "state->before_load[{j}]")
    inputs = _sample_inputs(fit, made) | numbers
    inputs["load"] = each(made.load, "load[{j}]")
    inputs |= {f"before_{name}": given for name, given in past.items()}
    arguments = ["state", "sample", "load", "smooth_velocity", *(["numbers"] if numbers else [])]
    return body(ca.densify(made.advance(before)), inputs, to="after", arguments=arguments)


def _motion_inputs(motion: Motion, *, of: str = "") -> dict[str, FunctionInput]:
    """Return the inputs of functions of the motion; ``of``: C of a sample, such as ``sample->``."""
    return {
        "q": each(motion.q, of + "q[{j}]"),
        "sin": each(motion.sin, f"sin({of}q[{{j}}])"),
        "cos": each(motion.cos, f"cos({of}q[{{j}}])"),
        "dq": each(motion.dq, of + "dq[{j}]"),
        "ddq": each(motion.ddq, of + "ddq[{j}]"),
    }


def signal_inputs(fit: Fit, symbols: ExportExpressions, *, of: str) -> dict[str, FunctionInput]:
    """Return the inputs of functions of a whole sample; ``of``: its C, such as ``sample->``."""
    mean = fit.temperature_mean
    warmth = [
        f"{of}temperature[{j}]" + (f" - {number(mean[j])}" if mean is not None else "")
        for j in range(fit.model.n)
    ]
    return _motion_inputs(symbols.motion, of=of) | {
        "sign": each(symbols.sign, f"lieid_direction({of}dq[{{j}}], smooth_velocity, {{j}})"),
        "temperature": FunctionInput(symbols.temperature, tuple(warmth)),
        "time": FunctionInput(symbols.time, (f"{of}time",)),
    }


def _sample_inputs(fit: Fit, made: ExportExpressions) -> dict[str, FunctionInput]:
    """Return the inputs of functions of the sample and the state."""
    states = {"states": each(made.states, "state->values[{j}]")}
    return signal_inputs(fit, made, of="sample->") | states
