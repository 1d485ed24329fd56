"""``lieid export FIT --to c``: a fitted model as C99 for a controller."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from lieid_casadi.codegen_files import codegen_folder
from lieid_casadi.errors import ExportError
from lieid_casadi.exporters.c.arm_effects import arm_notes
from lieid_casadi.exporters.c.functions import (
    RUNTIME,
    WITHOUT_NUMBERS,
    ExportForm,
    exported_functions,
    select,
)
from lieid_casadi.exporters.c.numbers import DOUBLE, SINGLE
from lieid_casadi.exporters.c.prefix import check_prefix
from lieid_casadi.exporters.c.self_test import self_test_content
from lieid_casadi.exporters.c.template_variables import template_variables
from lieid_casadi.exporters.c.text import comment, render, wrapped
from lieid_casadi.identification.fit import Fit
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

    ``prefix``: of files and functions; ``names``: functions, in the order of `NAMES`; ``notes``:
    what the export leaves out.
    """
    made = exported_functions(fit, names, form)
    content = template_variables(fit, prefix, made, form) | {
        "notes": [comment(note) for note in notes]
    }
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
