"""Sections of a diagnosis: findings, evidence, rejected candidates, unexplained residual."""

from __future__ import annotations

from typing import TYPE_CHECKING

from lieid_casadi.diagnosis import text_summary
from lieid_casadi.report.picture import data_uri
from lieid_casadi.report.section import Section, table_section
from lieid_casadi.report.sections.effects import anchors
from lieid_casadi.report.sections.pictures import picture_section

if TYPE_CHECKING:
    from lieid_casadi.diagnosis import Diagnosis


def finding_section(diagnosis: Diagnosis) -> Section:
    """Return the verdict and the error of each model."""
    errors = text_summary.error_table(diagnosis)
    sentences = text_summary.sentences(diagnosis)
    return table_section("Verdict", errors, sentences=sentences, titles=True)


def waterfall_section(diagnosis: Diagnosis) -> Section:
    """Return the figure of the errors of all models."""
    return picture_section("From the first model to the last", diagnosis.plot(), "")


def evidence_section(diagnosis: Diagnosis) -> Section:
    """Return evidence, rivals and parameters of each step, and the rejected candidates."""
    return table_section(
        "Evidence",
        text_summary.evidence_table(diagnosis),
        text_summary.unexplained_table(diagnosis),
        text_summary.rejected_table(diagnosis),
        titles=True,
        links=anchors(step.effect for step in diagnosis.steps),
    )


def unexplained_section(diagnosis: Diagnosis) -> Section:
    """Return the shape of the unexplained residual, and its code as a user-defined effect."""
    from lieid_casadi.diagnosis.residual.user_effect_code import own_effects

    own = own_effects(diagnosis.unexplained)
    drawn = any(part.shapes for part in diagnosis.unexplained)
    data = {
        "uri": data_uri(diagnosis.plot_unexplained()) if drawn else "",
        "code": own.code,
        "options": text_summary.rerun_options(diagnosis, own.labels) if own.labels else "",
    }
    return Section("Unexplained residual", "unexplained.html", data)
