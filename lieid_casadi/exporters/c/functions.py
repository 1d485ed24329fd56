"""The functions that exported C may have, and their bodies as statements of plain C99."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import casadi as ca

from lieid_casadi.dynamics.lie import Motion
from lieid_casadi.errors import ExportError
from lieid_casadi.exporters.c.expressions import (
    ExportExpressions,
    SampleSymbols,
    export_expressions,
)
from lieid_casadi.expressions.c_writer import ARITHMETIC, Dialect, UnsupportedOperation, statements
from lieid_casadi.expressions.forward_dynamics import obstacle
from lieid_casadi.expressions.model_functions import sparse_function
from lieid_casadi.expressions.torque import TorqueExpressions, Values
from lieid_casadi.identification.fit import Fit

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
    matrix: ca.SX,
    inputs: Mapping[str, FunctionInput],
    *,
    to: str,
    arguments: Sequence[str] = (),
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
    before = SampleSymbols.before(fit.model.n)
    past = _signal_inputs(fit, before, of="state->before.")
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


def _signal_inputs(
    fit: Fit, symbols: SampleSymbols | ExportExpressions, *, of: str
) -> dict[str, FunctionInput]:
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
    return _signal_inputs(fit, made, of="sample->") | states
