"""The functions that exported C may have, and their bodies."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import casadi as ca

from lieid_casadi.errors import ExportError
from lieid_casadi.exporters.c.expressions import ExportExpressions, ExportSymbols, model_numbers
from lieid_casadi.exporters.c.numbers import DOUBLE, Precision
from lieid_casadi.exporters.c.statements import FunctionBody, FunctionInput, body, each
from lieid_casadi.expressions.forward_dynamics import obstacle
from lieid_casadi.expressions.torque import TorqueExpressions, Values
from lieid_casadi.identification.fit import Fit

RIGID_ARGUMENTS = {  # function: its arguments before the result
    "rigid_torque": ("q", "dq", "ddq"),
    "gravity": ("q",),
    "mass_matrix": ("q",),
    "coriolis": ("q", "dq"),
    "forward_kinematics": ("q",),
    "jacobian": ("q",),
    "regressor": ("q", "dq", "ddq"),
    "slotine_li_regressor": ("q", "dq", "dq_r", "ddq_r"),
}
SAMPLE_ARGUMENTS = {  # function: its argument between the sample and the state
    "friction": "load",
    "torque": "",
    "forward_dynamics": "torque",
    "effect_columns": "load",
    "base_regressor": "load",
}
NAMES = (*RIGID_ARGUMENTS, *SAMPLE_ARGUMENTS)
WITHOUT_NUMBERS = ("forward_kinematics", "jacobian", "regressor", "slotine_li_regressor")
RUNTIME = ("payload", "parameters")  # numbers that may be inputs
_RESULTS = {  # name of the result, where it is no matrix
    "rigid_torque": "torque",
    "gravity": "torque",
    "forward_kinematics": "pose",
    "friction": "torque",
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


def select(fit: Fit, requested: Sequence[str] | None) -> tuple[list[str], list[str]]:
    """Return the names of the functions to export, in the order of `NAMES`, and notes.

    ``requested``: names of `NAMES`; None stands for all that the fit has.
    Raises `ExportError`: a name is not one of `NAMES`, or the fit does not have that function.
    """
    wanted = list(NAMES) if requested is None else list(requested)
    unknown = [name for name in wanted if name not in NAMES]
    if unknown or not wanted:
        raise ExportError(
            f"functions: got {', '.join(map(repr, unknown)) or 'none'}; "
            f"expected some of {', '.join(NAMES)}"
        )
    missing: dict[str, str] = {}
    if "forward_dynamics" in wanted:
        missing = _no_forward_dynamics(fit)
    notes = [f"{name} is left out: {reason}" for name, reason in missing.items()]
    if not fit.model.columns:
        missing["effect_columns"] = "the fit has no effects"
    refused = [name for name in wanted if name in missing]
    if requested is not None and refused:
        raise ExportError(f"function {refused[0]}: {missing[refused[0]]}")
    return [name for name in NAMES if name in wanted and name not in missing], notes


def _no_forward_dynamics(fit: Fit) -> dict[str, str]:
    """Return why the fit has no forward dynamics, by the name of the function; empty if it has."""
    values = Values.numbers(fit.link_parameters, fit.effect_coefficients, fit.shapes)
    torque = TorqueExpressions(fit.model, values, None, as_measured=False, payload=False)
    reason = obstacle(
        torque, remedy="lieid identify --method feasible gives a fit whose mass matrix is"
    )
    return {"forward_dynamics": reason} if reason else {}


@dataclass(frozen=True)
class ExportForm:
    """How numbers appear in exported C.

    Attributes
    ----------
    precision : Precision
        The floating-point type.
    runtime : tuple of str
        Those of `RUNTIME` that are arguments of the functions instead of constants.
    """

    precision: Precision = DOUBLE
    runtime: tuple[str, ...] = ()


CONSTANTS = ExportForm()


def exported_functions(
    fit: Fit, names: Sequence[str], form: ExportForm = CONSTANTS
) -> ExportedFunctions:
    """Return the C of functions, and of those that they call.

    ``names``: result of `select`.
    Raises `ExportError`: an effect uses an operation without a C form, or needs more than one
    instant.
    """
    now = ExportSymbols.of(fit)
    values = model_numbers(fit, form.runtime)
    expressions = ExportExpressions(fit, now, values)
    numbers = {name: each(x, f"numbers->{name}[{{j}}]") for name, x in values.inputs.items()}
    rigid = (
        rigid_inputs(now, form.precision)
        | numbers
        | {
            "dq_r": each(now.dq_r, "dq_r[{j}]"),
            "ddq_r": each(now.ddq_r, "ddq_r[{j}]"),
        }
    )
    sample = sample_inputs(fit, now, form.precision, of="sample->") | numbers
    further = {
        "": {},
        "load": {"load": each(now.load, "load[{j}]")},
        "torque": {"torque": each(now.torque, "torque[{j}]")},
    }
    used = any(name in SAMPLE_ARGUMENTS for name in names)
    advance = None
    if fit.model.states and used:
        advance = _advance(fit, expressions, now, form, numbers)
    remembers = advance is not None and "before_load" in advance.used
    reads = remembers or (advance is not None and "load" in advance.used)
    bodies = {}
    for name in NAMES:
        if name in names or (name == "rigid_torque" and reads):
            inputs = rigid if name in RIGID_ARGUMENTS else sample | further[SAMPLE_ARGUMENTS[name]]
            bodies[name] = body(
                getattr(expressions, name),
                inputs,
                to=_RESULTS.get(name, "matrix"),
                arguments=_arguments(name, form),
                precision=form.precision,
            )
    return ExportedFunctions(bodies, advance, remembers, reads)


def _arguments(name: str, form: ExportForm) -> list[str]:
    """Return the names of a C function's arguments."""
    numbers = ["numbers"] if form.runtime and name not in WITHOUT_NUMBERS else []
    if name in RIGID_ARGUMENTS:
        return [*RIGID_ARGUMENTS[name], *numbers]
    given = [SAMPLE_ARGUMENTS[name]] if SAMPLE_ARGUMENTS[name] else []
    return ["sample", *given, "state", "v0", *numbers]


def _advance(
    fit: Fit,
    expressions: ExportExpressions,
    now: ExportSymbols,
    form: ExportForm,
    numbers: dict[str, FunctionInput],
) -> FunctionBody:
    """Return the body that computes the states at a sample from those at the sample before."""
    before = ExportSymbols.of(fit, "before_")
    after = expressions.advance(before)
    past = sample_inputs(fit, before, form.precision, of="state->before.")
    past["load"] = each(before.load, "state->before_load[{j}]")
    inputs = sample_inputs(fit, now, form.precision, of="sample->") | numbers
    inputs["load"] = each(now.load, "load[{j}]")
    inputs |= {f"before_{name}": given for name, given in past.items()}
    inputs["states"] = inputs.pop("before_states")
    arguments = ["state", "sample", "load", "v0", *(["numbers"] if form.runtime else [])]
    return body(
        ca.densify(after), inputs, to="after", arguments=arguments, precision=form.precision
    )


def rigid_inputs(
    symbols: ExportSymbols, precision: Precision, *, of: str = ""
) -> dict[str, FunctionInput]:
    """Return the inputs of functions of the motion alone.

    ``of``: C expression of a sample, such as ``sample->``, whose members are read.
    """
    motion = symbols.motion
    return {
        "q": each(motion.q, of + "q[{j}]"),
        "sin": each(motion.sin, f"{precision.call('sin')}({of}q[{{j}}])"),
        "cos": each(motion.cos, f"{precision.call('cos')}({of}q[{{j}}])"),
        "dq": each(motion.dq, of + "dq[{j}]"),
        "ddq": each(motion.ddq, of + "ddq[{j}]"),
    }


def sample_inputs(
    fit: Fit, symbols: ExportSymbols, precision: Precision, *, of: str
) -> dict[str, FunctionInput]:
    """Return the inputs of functions of a whole sample and the state.

    ``of``: C expression of the sample, such as ``sample->``.
    """
    mean = fit.temperature_mean
    warmth = [
        f"{of}temperature[{j}]" + (f" - {precision.number(mean[j])}" if mean is not None else "")
        for j in range(fit.model.n)
    ]
    direction = precision.call("lieid_direction")
    return rigid_inputs(symbols, precision, of=of) | {
        "sign": each(symbols.sign, f"{direction}({of}dq[{{j}}], v0, {{j}})"),
        "temperature": FunctionInput(symbols.temperature, tuple(warmth)),
        "time": FunctionInput(symbols.time, (f"{of}time",)),
        "states": each(symbols.states, "state->values[{j}]"),
    }
