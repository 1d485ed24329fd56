"""What a diagnosis found, how sure it is, and what it turned down."""

from __future__ import annotations

from typing import TYPE_CHECKING

from lieid_casadi.report.picture import data_uri
from lieid_casadi.report.section import Section
from lieid_casadi.report.sections.pictures import picture_section

if TYPE_CHECKING:
    from lieid_casadi.diagnosis import Diagnosis


def finding_section(diagnosis: Diagnosis) -> Section:
    """Return the verdict in one sentence and the error of each model on the way."""
    from lieid_casadi.diagnosis.text_summary import rows

    headings, table = rows(diagnosis)
    measured, _ = diagnosis.shown
    errors = {
        "title": f"RMS error on the {measured}, N·m",
        "headings": headings,
        "rows": [[_text(cell) for cell in row] for row in table],
        "note": "Each row adds one effect to the row above and fits everything again. p: "
        "family-wise, for everything that was tried. The test chooses nothing.",
    }
    data = {"sentence": diagnosis.sentence, "tables": [errors]}
    return Section("Verdict", "diagnosis.html", data)


def waterfall_section(diagnosis: Diagnosis) -> Section:
    """Return the picture of the error falling."""
    return picture_section("From the first model to the last", diagnosis.plot(), "")


def evidence_section(diagnosis: Diagnosis) -> Section:
    """Return how sure each step is, its rivals and its parameters."""
    from lieid_casadi.diagnosis.text_summary import where

    steps = [
        [
            step.effect,
            where(step.joints),
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
            "cannot be told from",
        ],
        "rows": steps,
        "note": "exact: no data can tell the two apart; data: this data cannot.",
    }  # fmt: skip
    left = {
        "title": "Unexplained",
        "headings": ["joint", "part of the error's variance", "follows", "looks like, N·m"],
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
        "title": f"Turned down ({diagnosis.tried} candidates were tried)",
        "headings": ["effect", "because"],
        "rows": [list(pair) for pair in diagnosis.rejected],
        "note": diagnosis.aliases.sentence,
    }
    return Section(
        "Evidence", "diagnosis.html", {"sentence": "", "tables": [found, left, rejected]}
    )


def unexplained_section(diagnosis: Diagnosis) -> Section:
    """Return the shape of what stays unexplained, and the lines that make it an effect."""
    from lieid_casadi.diagnosis.residual.user_effect_code import own_effects
    from lieid_casadi.diagnosis.text_summary import again

    own = own_effects(diagnosis.unexplained)
    drawn = any(part.shapes for part in diagnosis.unexplained)
    data = {
        "uri": data_uri(diagnosis.plot_unexplained()) if drawn else "",
        "code": own.code,
        "options": again(diagnosis, own.labels) if own.labels else "",
    }
    return Section("What stays unexplained", "unexplained.html", data)


def _text(cell: object) -> str:
    if cell is None:
        return "–"
    if isinstance(cell, float):
        return "–" if cell != cell else f"{cell:.3g}"
    return str(cell)
