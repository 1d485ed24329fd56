"""Sections of a diagnosis: findings, evidence, rejected candidates, unexplained residual."""

from __future__ import annotations

from typing import TYPE_CHECKING

from lieid_casadi.report.picture import data_uri
from lieid_casadi.report.section import Section
from lieid_casadi.report.sections.pictures import picture_section

if TYPE_CHECKING:
    from lieid_casadi.diagnosis import Diagnosis


def finding_section(diagnosis: Diagnosis) -> Section:
    """Return the verdict in one sentence and the error of each model on the way."""
    from lieid_casadi.diagnosis.text_summary import error_table

    headings, table = error_table(diagnosis)
    measured, _ = diagnosis.shown
    errors = {
        "title": f"RMS error on the {measured}, N·m",
        "headings": headings,
        "rows": [[_text(cell) for cell in row] for row in table],
        "note": "Each row adds one effect to the row above and fits all parameters again. p: "
        "family-wise p-value over all candidates. Steps are selected on the training recordings.",
    }
    data = {"sentence": diagnosis.sentence, "tables": [errors]}
    return Section("Verdict", "diagnosis.html", data)


def waterfall_section(diagnosis: Diagnosis) -> Section:
    """Return the figure of the errors of all models."""
    return picture_section("From the first model to the last", diagnosis.plot(), "")


def evidence_section(diagnosis: Diagnosis) -> Section:
    """Return evidence, rivals and parameters of each step."""
    from lieid_casadi.diagnosis.text_summary import location

    steps = [
        [
            step.effect,
            location(step.joints),
            ", ".join(f"{name} = {value:.4g}" for name, value in step.parameters.items()),
            _text(step.evidence.effect_size),
            f"{step.evidence.held_out_before:.3g} → {step.evidence.held_out_after:.3g}",
            {True: "yes", False: "no", None: "–"}[step.evidence.confirmed],
            ", ".join(
                f"{rival.placement.label} ({kind})" for rival, kind in step.indistinguishable[:3]
            )
            or "–",
        ]
        for step in diagnosis.steps
    ]
    found = {
        "title": "Evidence",
        "headings": [
            "effect", "on", "parameters", "size, N·m", "held-out error, N·m", "test confirms",
            "fits as well",
        ],
        "rows": steps,
        "note": "exact: no data can separate the two; data: these data cannot.",
    }  # fmt: skip
    left = {
        "title": "Unexplained",
        "headings": [
            "joint",
            "part of the residual's variance",
            "depends on",
            "approximately, N·m",
        ],
        "rows": [
            [
                f"{u.joint + 1}",
                f"{100 * u.fraction:.0f} %",
                ", ".join(u.depends_on),
                "–" if u.formula is None else u.formula.text,
            ]
            for u in diagnosis.unexplained
        ],
        "note": "Cross-validated.",
    }
    rejected = {
        "title": f"Rejected ({diagnosis.tried} candidates were tried)",
        "headings": ["effect", "because"],
        "rows": [list(pair) for pair in diagnosis.rejected],
        "note": diagnosis.aliases.sentence,
    }
    return Section(
        "Evidence", "diagnosis.html", {"sentence": "", "tables": [found, left, rejected]}
    )


def unexplained_section(diagnosis: Diagnosis) -> Section:
    """Return the shape of the unexplained residual, and its code as a user-defined effect."""
    from lieid_casadi.diagnosis.residual.user_effect_code import own_effects
    from lieid_casadi.diagnosis.text_summary import rerun_options

    own = own_effects(diagnosis.unexplained)
    drawn = any(part.shapes for part in diagnosis.unexplained)
    data = {
        "uri": data_uri(diagnosis.plot_unexplained()) if drawn else "",
        "code": own.code,
        "options": rerun_options(diagnosis, own.labels) if own.labels else "",
    }
    return Section("Unexplained residual", "unexplained.html", data)


def _text(cell: object) -> str:
    if cell is None:
        return "–"
    if isinstance(cell, float):
        return "–" if cell != cell else f"{cell:.3g}"
    return str(cell)
