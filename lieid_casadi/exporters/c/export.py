"""``lieid export FIT --to c``: a fitted model as C99 for a controller."""

from __future__ import annotations

import re
import textwrap
import unicodedata
from collections.abc import Iterable, Sequence
from functools import cache
from typing import TYPE_CHECKING, Any

import numpy as np

from lieid_casadi.arrays import Array
from lieid_casadi.codegen_files import codegen_folder
from lieid_casadi.effects import ArmEffect
from lieid_casadi.errors import ExportError
from lieid_casadi.exporters.c.functions import (
    SAMPLE_ARGUMENTS,
    TOLERANCE,
    ExportedFunctions,
    available,
    exported_functions,
    number,
)
from lieid_casadi.exporters.c.self_test import self_test_content
from lieid_casadi.identification.fit import Fit
from lieid_casadi.model import Model, Parameter
from lieid_casadi.robot import Robot

if TYPE_CHECKING:
    from jinja2 import Environment

WIDTH = 96
HEADER = "lieid_runtime.h"  # of every export


def c_files(
    fit: Fit, *, prefix: str = "arm", payload: bool = False
) -> tuple[dict[str, bytes], list[str]]:
    """Return library, self-test and CMake project by file name, and notes for their users.

    The self-test compares results with CasADi. Options are those of `lieid_casadi.export`.
    """
    if not re.fullmatch(r"(?!lieid_)[a-z][a-z0-9_]*", prefix, re.ASCII | re.IGNORECASE):
        raise ExportError(
            f"prefix {prefix!r}: expected letters, digits and _, beginning with a letter and not "
            "with lieid_"
        )
    for value in (*fit.parameters, *fit.values, *fit.shapes):
        number(value)
    names, left_out = available(fit)
    notes = [*left_out, *_notes(fit)]
    made = exported_functions(fit, names, payload=payload)
    content = {
        "note_lines": wrapped(comment(note) for note in notes),
        **_of_form(prefix, payload),
        **_of_fit(fit),
        **_of_model(fit.model),
        **_of_functions(fit.model, made),
        **self_test_content(fit, made.bodies, payload=payload),
    }
    templates = {
        f"{prefix}.h": "arm.h.jinja",
        f"{prefix}.c": "arm.c.jinja",
        f"{prefix}_parameters.c": "arm_parameters.c.jinja",
        f"{prefix}_test.c": "arm_test.c.jinja",
        "CMakeLists.txt": "CMakeLists.txt.jinja",
    }
    files = {
        name: _environment().get_template(template).render(content).encode()
        for name, template in templates.items()
    }
    return files | {HEADER: (codegen_folder() / "export" / HEADER).read_bytes()}, notes


def _notes(fit: Fit) -> list[str]:
    """Return notes for users of the code."""
    notes = []
    if not fit.physically_consistent:
        notes.append(
            "the link parameters are not physically consistent: torques are correct, but the mass "
            "matrix may not be positive definite; lieid identify --method feasible gives a "
            "consistent fit"
        )
    timed = [p.label for p in fit.model.placements if "time" in p.effect.signals]
    if set(timed) - {p.label for p in fit.model.placements if p.effect.states}:
        notes.append(f"{', '.join(timed)}: time counts from the start of the motion")
    inside = []
    for p in fit.model.placements:
        if isinstance(p.effect, ArmEffect):
            if p.effect.export_note:
                notes.append(f"{p.label}: {p.effect.export_note}")
            else:
                inside.append(p.label)
    if inside:
        notes.append(f"{', '.join(inside)}: part of effect_torque, not of rigid_torque")
    return notes


def comment(text: str) -> str:
    """Return text that is safe in a C comment, in one line.

    Names come from the user's files: comment marks, line ends (also by a backslash) and characters
    that reorder the text are removed.
    """
    shown = "".join(c if unicodedata.category(c)[0] != "C" else " " for c in text)
    shown = " ".join(shown.replace("\\", "/").split())
    return shown.replace("*/", "* /").replace("/*", "/ *").replace("??", "? ?")


def string(text: str) -> str:
    """Return text as a literal of C, in UTF-8."""
    plain = [chr(b) if 32 <= b < 127 and b not in b'"\\?' else f"\\{b:03o}" for b in text.encode()]
    return f'"{"".join(plain)}"'


def numbers(values: Array) -> str:
    """Return the initializers of an array, wrapped."""
    words = ", ".join(number(float(value)).strip("()") for value in np.ravel(values))
    return textwrap.fill(words, WIDTH, initial_indent="    ", subsequent_indent="    ")


def numbered(names: Iterable[str]) -> list[str]:
    """Return lines ``0 NAME, 1 NAME, …`` for a comment."""
    words = [f"{k} {comment(name)}".replace(" ", "\0") for k, name in enumerate(names)]
    lines = textwrap.wrap(", ".join(words), WIDTH - 6, break_on_hyphens=False)
    return [line.replace("\0", " ") for line in lines]


def wrapped(texts: Iterable[str]) -> list[str]:
    """Return texts as lines of a list for a comment."""
    lines = []
    for text in texts:
        lines += textwrap.wrap(text, WIDTH - 4, initial_indent="- ", subsequent_indent="  ")
    return lines


@cache
def _environment() -> Environment:
    from jinja2 import Environment, FileSystemLoader, StrictUndefined

    environment = Environment(
        loader=FileSystemLoader(codegen_folder() / "export"),
        autoescape=False,  # C, not HTML; names pass through `comment`
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
    )
    environment.filters["numbers"] = numbers
    return environment


def _of_form(prefix: str, payload: bool) -> dict[str, Any]:
    return {
        "tolerance": TOLERANCE,
        "payload": payload,
        # the argument of run-time numbers: of a function, of `advance`, in calls of these
        "N": f"const {prefix}_numbers *numbers, " if payload else "",
        "M": f", const {prefix}_numbers *numbers" if payload else "",
        "B": "&numbers, " if payload else "",
        "C": ", &numbers" if payload else "",
        "p": prefix,
        "P": prefix.upper(),
    }


def _of_fit(fit: Fit) -> dict[str, Any]:
    """Return the identified numbers and where they are from."""
    from lieid_casadi import __version__

    model = fit.model
    base = [model.base.expression(k) for k in range(model.base.count)]
    return {
        "version": __version__,
        "method": fit.method,
        "recordings": [
            comment(f"{s.name} (SHA-256 {s.sha256})") for s in fit.provenance.recordings
        ],
        "links": [
            {"label": parameter.label, "number": _initializer(value)}
            for parameter, value in zip(model.link_parameters, fit.link_parameters, strict=True)
        ],
        "base": _rows(model.base_columns, fit.values, base, fit.std),
        "coefficients": _rows(model.columns, fit.effect_coefficients),
        "shapes": _rows(model.shapes, fit.shapes, stds=fit.std[len(fit.values) :]),
    }


def _of_model(model: Model) -> dict[str, Any]:
    """Return joints, units, effects and the states of these."""
    robot = model.robot
    kinds = {joint.revolute for joint in robot.joints}
    formulas = {p.effect.label: p.effect.formula for p in model.placements}
    return {
        "robot": comment(robot.name),
        "n": model.n,
        "joints": [
            {"name": comment(j.name), "revolute": j.revolute, "literal": string(j.name)}
            for j in robot.joints
        ],
        "name_size": max(len(j.name.encode()) for j in robot.joints) + 1,
        "limits": _limits(robot, _units(kinds)),
        "turns": True in kinds,
        "slides": False in kinds,
        "units": _units(kinds),
        "effects": comment(", ".join(model.effects)),
        "formulas": [{"label": comment(k), "formula": comment(v)} for k, v in formulas.items()],
        "states": [
            {
                "place": place,
                "label": comment(state.label),
                "unit": comment(state.unit),
                "initial": f"{state.initial:g}",
                "number": number(state.initial),
            }
            for place, state in enumerate(model.states)
        ],
        "coefficient_lines": numbered(f"{c.label} [{c.unit}]" for c in model.columns),
        "base_lines": numbered(f"{c.label} [{c.unit}]" for c in model.base_columns),
    }


def _of_functions(model: Model, made: ExportedFunctions) -> dict[str, Any]:
    """Return the bodies of the exported functions and what they read."""
    used = [function.used for name, function in made.bodies.items() if name in SAMPLE_ARGUMENTS]
    used += [made.advance.used] if made.advance else []
    return {
        "bodies": made.bodies,
        "advance": made.advance,
        "remembers_load": made.remembers_load,
        "advance_reads_load": made.advance_reads_load,
        "reads_load": any("load" in p.effect.signals for p in model.placements),
        "reads": {name.removeprefix("before_") for names in used for name in names},
    }


def _rows(
    parameters: Sequence[Parameter],
    values: Array,
    labels: Sequence[str] | None = None,
    stds: Array | None = None,
) -> list[dict[str, str]]:
    """Return value, name and unit of parameters, safe in a comment."""
    return [
        {
            "label": comment(parameter.label if labels is None else labels[k]),
            "unit": comment(parameter.unit),
            "number": _initializer(values[k]),
            "std": "" if stds is None else f"{stds[k]:.3g}",
        }
        for k, parameter in enumerate(parameters)
    ]


def _initializer(value: float) -> str:
    return number(value).strip("()")


def _limits(robot: Robot, units: dict[str, str]) -> list[dict[str, str]]:
    """Return name in C, unit and initializers of each kind of limit of the joints."""
    found = []
    for name, key, unit in (
        ("position_lower", "position_lower", "q"), ("position_upper", "position_upper", "q"),
        ("velocity_limit", "velocity", "dq"), ("acceleration_limit", "acceleration", "ddq"),
        ("torque_limit", "torque", "tau"),
    ):  # fmt: skip
        none = "-HUGE_VAL" if name == "position_lower" else "HUGE_VAL"
        stated = robot.limit(key)
        words = [_initializer(x) if np.isfinite(x) else none for x in stated]
        found.append({"name": name, "unit": units[unit], "text": ", ".join(words)})
    return found


def _units(kinds: set[bool]) -> dict[str, str]:
    turning = {"q": "rad", "dq": "rad/s", "ddq": "rad/s²", "tau": "N·m"}
    sliding = {"q": "m", "dq": "m/s", "ddq": "m/s²", "tau": "N"}
    pairs = [units for kind, units in ((True, turning), (False, sliding)) if kind in kinds]
    return {key: " or ".join(units[key] for units in pairs) for key in turning}
