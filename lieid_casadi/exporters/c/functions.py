"""The functions that exported C may have, and their bodies."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import casadi as ca

from lieid_casadi.dynamics.lie import Motion
from lieid_casadi.errors import ExportError
from lieid_casadi.exporters.c.expressions import (
    ExportExpressions,
    SampleSymbols,
    export_expressions,
)
from lieid_casadi.exporters.c.statements import (
    FunctionBody,
    FunctionInput,
    body,
    each,
    number,
)
from lieid_casadi.expressions.forward_dynamics import obstacle
from lieid_casadi.expressions.torque import TorqueExpressions, Values
from lieid_casadi.identification.fit import Fit

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
RUNTIME = ("payload", "parameters")  # numbers that may be inputs
_RESULTS = {  # name of the result, where it is no matrix
    "rigid_torque": "torque",
    "gravity": "torque",
    "forward_kinematics": "pose",
    "friction": "torque",
    "effect_torque": "torque",
    "torque": "torque",
    "forward_dynamics": "acceleration",
}
NUMBERS = {"parameters": "link_parameters", "effects": "effect_coefficients"}  # input: name in C


@dataclass(frozen=True, eq=False)
class ExportedFunctions:
    """Bodies of the C functions by name, and what the states of effects depend on."""

    bodies: dict[str, FunctionBody]
    advance: FunctionBody | None
    remembers_load: bool
    advance_reads_load: bool


def select(fit: Fit, requested: Sequence[str] | None) -> tuple[list[str], list[str]]:
    """Return the names of the functions to export, in the order of `NAMES`, and notes.

    None stands for all that the fit has; an `ExportError` names a function that it does not have.
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


def exported_functions(
    fit: Fit, names: Sequence[str], runtime: Sequence[str] = ()
) -> ExportedFunctions:
    """Return the C of functions (of `select`), and of those that they call.

    ``runtime``: numbers that are arguments, of `RUNTIME`.
    """
    made = export_expressions(fit, runtime)
    numbers = {
        NUMBERS.get(name, name): each(symbol, f"numbers->{NUMBERS.get(name, name)}[{{j}}]")
        for name, symbol in made.further_inputs(static=True).items()
    }
    references = {"dq_r": each(made.dq_r, "dq_r[{j}]"), "ddq_r": each(made.ddq_r, "ddq_r[{j}]")}
    rigid = _motion_inputs(made.motion) | numbers | references
    sample = _sample_inputs(fit, made) | numbers
    further = {
        "": {},
        "load": {"load": each(made.load, "load[{j}]")},
        "torque": {"torque": each(made.tau, "torque[{j}]")},
    }
    advance = None
    if fit.model.states and any(name in SAMPLE_ARGUMENTS for name in names):
        advance = _advance(fit, made, runtime, numbers)
    remembers = advance is not None and "before_load" in advance.used
    reads = remembers or (advance is not None and "load" in advance.used)
    bodies = {}
    for name in NAMES:
        if name in names or (name == "rigid_torque" and reads):
            inputs = rigid if name in RIGID_ARGUMENTS else sample | further[SAMPLE_ARGUMENTS[name]]
            bodies[name] = body(
                getattr(made, name),
                inputs,
                to=_RESULTS.get(name, "matrix"),
                arguments=_arguments(name, runtime),
            )
    return ExportedFunctions(bodies, advance, remembers, reads)


def _arguments(name: str, runtime: Sequence[str]) -> list[str]:
    """Return the names of a C function's arguments."""
    numbers = ["numbers"] if runtime and name not in WITHOUT_NUMBERS else []
    if name in RIGID_ARGUMENTS:
        return [*RIGID_ARGUMENTS[name], *numbers]
    given = [SAMPLE_ARGUMENTS[name]] if SAMPLE_ARGUMENTS[name] else []
    return ["sample", *given, "state", "smooth_velocity", *numbers]


def _advance(
    fit: Fit, made: ExportExpressions, runtime: Sequence[str], numbers: dict[str, FunctionInput]
) -> FunctionBody:
    """Return the body that computes the states at a sample from those at the sample before."""
    before = SampleSymbols.before(fit.model.n)
    past = _signal_inputs(fit, before, of="state->before.")
    past["load"] = each(before.load, "state->before_load[{j}]")
    inputs = _sample_inputs(fit, made) | numbers
    inputs["load"] = each(made.load, "load[{j}]")
    inputs |= {f"before_{name}": given for name, given in past.items()}
    arguments = ["state", "sample", "load", "smooth_velocity"]
    return body(
        ca.densify(made.advance(before)),
        inputs,
        to="after",
        arguments=[*arguments, *(["numbers"] if runtime else [])],
    )


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
