"""``lieid export FIT --to c``: a fitted model as C99 for a controller."""

from __future__ import annotations

import re
from collections.abc import Sequence

from lieid_casadi.codegen_files import codegen_folder
from lieid_casadi.effects import ArmEffect
from lieid_casadi.errors import ExportError
from lieid_casadi.exporters.c.functions import (
    RUNTIME,
    WITHOUT_NUMBERS,
    exported_functions,
    select,
)
from lieid_casadi.exporters.c.self_test import self_test_content
from lieid_casadi.exporters.c.statements import number
from lieid_casadi.exporters.c.templates import comment, render, template_variables, wrapped
from lieid_casadi.identification.fit import Fit

C_KEYWORDS = (
    "auto break case char const continue default do double else enum extern float for goto if "
    "inline int long register restrict return short signed sizeof static struct switch typedef "
    "union unsigned void volatile while alignas alignof bool constexpr false nullptr static_assert "
    "thread_local true typeof typeof_unqual asm fortran"
)
CPP_KEYWORDS = (
    "and and_eq bitand bitor catch char8_t char16_t char32_t class compl concept consteval "
    "constinit const_cast co_await co_return co_yield decltype delete dynamic_cast explicit export "
    "friend import module mutable namespace new noexcept not not_eq operator or or_eq private "
    "protected public reinterpret_cast requires static_cast template this throw try typeid "
    "typename using virtual wchar_t xor xor_eq final override"
)
OWN_FILES = "lieid_runtime"
_CLASHES = {
    **dict.fromkeys(C_KEYWORDS.split(), "a keyword of C"),
    **dict.fromkeys(CPP_KEYWORDS.split(), "a keyword of C++"),
    **dict.fromkeys(OWN_FILES.split(), "a file of every export"),
}


def check_prefix(prefix: str) -> None:
    """Refuse a prefix that gives no C names, or names that clash.

    Raises `ExportError`.

    Examples
    --------
    >>> check_prefix("left_arm")
    """
    if not re.fullmatch(r"[A-Za-z][A-Za-z0-9_]*", prefix, re.ASCII):
        raise ExportError(
            f"prefix {prefix!r}: expected letters, digits and _, beginning with a letter"
        )
    # file names differ by more than case on some systems, and macros are in capitals
    clash = _CLASHES.get(prefix.lower())
    if clash is None and prefix.lower().startswith("lieid_"):
        clash = "a name of the runtime header"
    if clash is not None:
        raise ExportError(f"prefix {prefix!r}: is {clash}; expected another, such as my_{prefix}")


def c_files(
    fit: Fit,
    *,
    prefix: str = "arm",
    functions: Sequence[str] | None = None,
    runtime: Sequence[str] = (),
) -> tuple[dict[str, bytes], list[str]]:
    """Return library, self-test, CMake project and README by file name, and notes for their users.

    The functions use no memory except their arguments, and of the mathematical library only sin,
    cos, exp, tanh, fabs and sqrt; the header states order, shape and unit of each argument. The
    self-test compares their results with CasADi. Options are those of `lieid_casadi.export`.

    Raises `ExportError`: the prefix is not usable, a function or a name in ``runtime`` does not
    exist, an effect has no C form or needs more than one instant, or a number is not finite.
    """
    check_prefix(prefix)
    for value in (*fit.parameters, *fit.values, *fit.shapes):
        number(value)
    unknown = [name for name in runtime if name not in RUNTIME]
    if unknown:
        raise ExportError(f"runtime: got {unknown[0]!r}; expected some of {', '.join(RUNTIME)}")
    chosen, left_out = select(fit, functions)
    notes = [*left_out, *_notes(fit)]
    if set(chosen) <= set(WITHOUT_NUMBERS):
        if runtime:
            notes.append(f"{', '.join(runtime)}: no function depends on it, so it is no argument")
        runtime = ()
    given = tuple(name for name in RUNTIME if name in runtime)
    made = exported_functions(fit, chosen, given)
    comments = [comment(note) for note in notes]
    content = template_variables(fit, prefix, made, given)
    content |= {"notes": comments, "note_lines": wrapped(comments)}
    content |= self_test_content(fit, made.bodies, given)
    templates = {
        f"{prefix}.h": "arm.h.jinja",
        f"{prefix}.c": "arm.c.jinja",
        f"{prefix}_parameters.c": "arm_parameters.c.jinja",
        f"{prefix}_test.c": "arm_test.c.jinja",
        "CMakeLists.txt": "CMakeLists.txt.jinja",
        "README.md": "README.md.jinja",
    }
    files = {name: render(template, content).encode() for name, template in templates.items()}
    header = "lieid_runtime.h"
    return files | {header: (codegen_folder() / "export" / header).read_bytes()}, notes


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
