"""``lieid export FIT --to c``: a fitted model as C99 for a controller."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from lieid_casadi.codegen_files import codegen_folder
from lieid_casadi.errors import ExportError
from lieid_casadi.exporters.c.arm_effects import arm_notes
from lieid_casadi.exporters.c.functions import (
    RIGID_ARGUMENTS,
    RUNTIME,
    SAMPLE_ARGUMENTS,
    WITHOUT_NUMBERS,
    ExportedFunctions,
    ExportForm,
    exported_functions,
    select,
)
from lieid_casadi.exporters.c.numbers import DOUBLE, SINGLE, Precision
from lieid_casadi.exporters.c.prefix import check_prefix
from lieid_casadi.exporters.c.self_test import self_test_content
from lieid_casadi.exporters.c.text import comment, numbered, render, wrapped
from lieid_casadi.identification.fit import Fit
from lieid_casadi.model import Parameter
from lieid_casadi.output_folder import check_folder, write_folder


@dataclass(frozen=True)
class CExport:
    """The files of an export, and notes for their users."""

    files: tuple[Path, ...]
    notes: tuple[str, ...]


def export_c(
    fit: Fit,
    folder: str | Path,
    *,
    prefix: str = "arm",
    functions: Sequence[str] | None = None,
    runtime: Sequence[str] = (),
    float32: bool = False,
    force: bool = False,
) -> CExport:
    """Write the identified model as C99: library, self-test, CMake project and README.

    The functions use no memory except their arguments, and of the mathematical library only sin,
    cos, exp, tanh, fabs and sqrt; the header states order, shape and unit of each argument. The
    self-test compares their results with CasADi.

    Parameters
    ----------
    fit : Fit
    folder : str or Path
        Made if it does not exist; written as a whole or not at all.
    prefix : str
        Prefix of all names, so that one program can contain several arms.
    functions : sequence of str, optional
        Functions to write, of `lieid_casadi.exporters.c.functions.NAMES`; those that they call are
        added. Default: all that the fit has. Forward dynamics are left out, with a note, if the
        mass matrix is not positive definite in a pose within the joint limits.
    runtime : sequence of str
        Numbers that are arguments of the functions, so that they may change while the program
        runs: ``payload`` (ten link parameters of a body at the tool) and ``parameters`` (all link
        parameters, effect coefficients and shape parameters). All others are constants.
    float32 : bool
        Single precision: values of type float, and a self-test with the tolerance of such values.
    force : bool
        Replace what an earlier export wrote into the folder; other files are kept.

    Returns
    -------
    CExport

    Raises
    ------
    ExportError
        The prefix is not usable, a function or a name in ``runtime`` does not exist, an effect has
        no C form or needs more than one instant, or a number is not finite.
    OutputError
        The folder has other content or cannot be written.
    """
    check_prefix(prefix)
    check_folder(folder, force=force)
    for value in (*fit.parameters, *fit.values, *fit.shapes):
        DOUBLE.number(value)
    unknown = [name for name in runtime if name not in RUNTIME]
    if unknown:
        raise ExportError(f"runtime: got {unknown[0]!r}; expected some of {', '.join(RUNTIME)}")
    chosen, left_out = select(fit, functions)
    notes = [*left_out, *_notes(fit)]
    if set(chosen) <= set(WITHOUT_NUMBERS):
        if runtime:
            notes.append(f"{', '.join(runtime)}: no function depends on it, so it is no argument")
        runtime = ()
    form = ExportForm(
        SINGLE if float32 else DOUBLE, tuple(name for name in RUNTIME if name in runtime)
    )
    written = write_folder(folder, c_files(fit, prefix, chosen, notes, form), force=force)
    return CExport(written, tuple(notes))


def c_files(
    fit: Fit, prefix: str, names: Sequence[str], notes: list[str], form: ExportForm
) -> dict[str, bytes]:
    """Return the content of all files by name.

    Parameters
    ----------
    fit : Fit
    prefix : str
        Of files and functions.
    names : sequence of str
        Functions, in the order of `NAMES`.
    notes : list of str
        What the export leaves out.
    form : ExportForm
    """
    made = exported_functions(fit, names, form)
    content = _content(fit, prefix, made, form) | {"notes": [comment(note) for note in notes]}
    content["note_lines"] = wrapped(content["notes"])
    templates = {
        f"{prefix}.h": "arm.h.jinja",
        f"{prefix}.c": "arm.c.jinja",
        f"{prefix}_parameters.c": "arm_parameters.c.jinja",
        f"{prefix}_test.c": "arm_test.c.jinja",
        "CMakeLists.txt": "CMakeLists.txt.jinja",
        "README.md": "README.md.jinja",
    }
    content |= self_test_content(fit, made.bodies, form)
    files = {name: render(template, content).encode() for name, template in templates.items()}
    headers = ["lieid_runtime.h", *(["lieid_runtime_float.h"] if form.precision.suffix else [])]
    return files | {name: (codegen_folder() / "export" / name).read_bytes() for name in headers}


def _content(fit: Fit, prefix: str, made: ExportedFunctions, form: ExportForm) -> dict[str, Any]:
    """Return the variables of the templates."""
    from lieid_casadi import __version__

    model, robot = fit.model, fit.model.robot
    used = [function.used for name, function in made.bodies.items() if name in SAMPLE_ARGUMENTS]
    used += [made.advance.used] if made.advance else []
    kinds = {joint.revolute for joint in robot.joints}
    formulas = {p.effect.label: p.effect.formula for p in model.placements}
    base = [model.base.expression(k) for k in range(model.base.count)]
    return {
        "precision": form.precision,
        "real": form.precision.real,
        "runtime": form.runtime,
        # the argument of run-time numbers: of a function, of `advance`, in calls of these
        "N": f"const {prefix}_numbers *numbers, " if form.runtime else "",
        "M": f", const {prefix}_numbers *numbers" if form.runtime else "",
        "B": "&numbers, " if form.runtime else "",
        "C": ", &numbers" if form.runtime else "",
        "p": prefix,
        "P": prefix.upper(),
        "version": __version__,
        "robot": comment(robot.name),
        "method": fit.method,
        "recordings": [
            {"name": comment(s.name), "sha256": comment(s.sha256)}
            for s in fit.provenance.recordings
        ],
        "n": model.n,
        "joints": [{"name": comment(j.name), "revolute": j.revolute} for j in robot.joints],
        "turns": True in kinds,
        "slides": False in kinds,
        "units": _units(kinds),
        "effects": comment(", ".join(model.effects)),
        "formulas": [{"label": comment(k), "formula": comment(v)} for k, v in formulas.items()],
        "links": [
            {"label": parameter.label, "number": _initializer(value, form.precision)}
            for parameter, value in zip(model.link_parameters, fit.link_parameters, strict=True)
        ],
        "base": _rows(form.precision, model.base_columns, fit.values, base, fit.std),
        "coefficients": _rows(form.precision, model.columns, fit.effect_coefficients),
        "shapes": _rows(form.precision, model.shapes, fit.shapes, stds=fit.std[len(fit.values) :]),
        "states": [
            {
                "place": place,
                "label": comment(state.label),
                "unit": comment(state.unit),
                "initial": f"{state.initial:g}",
                "number": form.precision.number(state.initial),
            }
            for place, state in enumerate(model.states)
        ],
        "coefficient_lines": numbered(f"{c.label} [{c.unit}]" for c in model.columns),
        "base_lines": numbered(f"{c.label} [{c.unit}]" for c in model.base_columns),
        "bodies": made.bodies,
        "rigid": [name for name in RIGID_ARGUMENTS if name in made.bodies],
        "of_samples": [name for name in SAMPLE_ARGUMENTS if name in made.bodies],
        "advance": made.advance,
        "remembers_load": made.remembers_load,
        "advance_reads_load": made.advance_reads_load,
        "reads_load": any("load" in p.effect.signals for p in model.placements),
        "reads": {name.removeprefix("before_") for names in used for name in names},
        "sizes": [(name, f.operations) for name, f in made.bodies.items()],
    }


def _rows(
    precision: Precision,
    parameters: tuple[Parameter, ...],
    values: Any,
    labels: Any = None,
    stds: Any = None,
) -> list[dict[str, str]]:
    """Return value, name and unit of parameters, safe in a comment."""
    return [
        {
            "label": comment(parameter.label if labels is None else labels[k]),
            "unit": comment(parameter.unit),
            "number": _initializer(values[k], precision),
            "std": "" if stds is None else f"{stds[k]:.3g}",
        }
        for k, parameter in enumerate(parameters)
    ]


def _initializer(value: float, precision: Precision) -> str:
    return precision.number(value).strip("()")


def _units(kinds: set[bool]) -> dict[str, str]:
    turning = {"q": "rad", "dq": "rad/s", "ddq": "rad/s²", "tau": "N·m"}
    sliding = {"q": "m", "dq": "m/s", "ddq": "m/s²", "tau": "N"}
    pairs = [units for kind, units in ((True, turning), (False, sliding)) if kind in kinds]
    return {key: " or ".join(units[key] for units in pairs) for key in turning}


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
    stateless = [p.label for p in fit.model.placements if p.effect.states]
    if set(timed) - set(stateless):
        notes.append(f"{', '.join(timed)}: time counts from the start of the motion")
    return notes + arm_notes(fit)
