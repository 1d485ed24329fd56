"""A diagnosis in words and tables."""

from __future__ import annotations

from collections.abc import Sequence
from html import escape
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from lieid_casadi.diagnosis.diagnosis import Diagnosis, DiagnosisStep


def where(joints: tuple[int, ...]) -> str:
    """Return ``joint 3``, ``joint 5 from joint 6`` or ``the whole arm`` (joints from 0 given)."""
    if not joints:
        return "the whole arm"
    if len(joints) == 2:
        return f"joint {joints[0] + 1} from joint {joints[1] + 1}"
    return f"joint {joints[0] + 1}"


def sentence(d: Diagnosis) -> str:
    """Return the verdict in words."""
    subject = "The model lacks" if d.mode == "missing" else "Since the fit has changed:"
    named = [f"{step.effect} on {where(step.joints)}" for step in d.steps]
    parts = []
    if named:
        parts.append(f"{subject} {', '.join(named)}.")
    elif d.verdict == "sufficient":
        parts.append(
            "Nothing in the library improves the model."
            if d.mode == "missing"
            else "Nothing has changed."
        )
    parts += [
        f"On joint {u.joint + 1} {100 * u.fraction:.0f} % of the remaining error's variance "
        f"follows {', '.join(u.depends_on)}, which no effect of the library explains"
        + ("." if u.formula is None else f"; it looks like {u.formula.text}.")
        for u in d.unexplained
    ]
    return " ".join(parts)


def again(d: Diagnosis, labels: Sequence[str]) -> str:
    """Return the options that run a diagnosis again with effects of the user's own in F.py."""
    if d.mode == "changed":  # the model is kept; registered effects are tried
        return "--effects-file F.py"
    return f"--effects-file F.py --effects '{','.join([*d.fit.model.effects, *labels])}'"


def rows(d: Diagnosis) -> tuple[list[str], list[list[object]]]:
    """Return headings and one row per model, first to last: errors per joint."""
    _, errors = d.shown
    heading = [f"{j + 1} {name}" for j, name in enumerate(d.joint_names)]
    names = ["+".join(d.baseline_effects) or "rigid", *(f"+ {step.label}" for step in d.steps)]
    sure = [None, *(_sure(step) for step in d.steps)]
    table: list[list[object]] = [
        [name, *map(float, values), p] for name, values, p in zip(names, errors, sure, strict=True)
    ]
    table.append(["noise floor", *map(float, d.noise_floor), None])
    return ["model", *heading, "p"], table


def _sure(step: DiagnosisStep) -> str:
    exponent = step.evidence.log10_p
    return f"{10.0**exponent:.2g}" if exponent > -15 else f"1e{max(exponent, -1e6):.0f}"


def html(d: Diagnosis) -> str:
    """Return the verdict and the table as HTML."""
    headings, table = rows(d)
    head = "".join(f"<th>{escape(h)}</th>" for h in headings)
    body = "".join(
        "<tr>" + "".join(f"<td>{escape(_cell(cell))}</td>" for cell in row) + "</tr>"
        for row in table
    )
    return (
        f"<p><b>{escape(sentence(d))}</b></p>"
        f"<table><thead><tr>{head}</tr></thead><tbody>{body}</tbody></table>"
    )


def _cell(cell: object) -> str:
    if cell is None:
        return ""
    if isinstance(cell, float):
        return "–" if np.isnan(cell) else f"{cell:.3g}"
    return str(cell)
