"""Reports of fits, comparisons, diagnoses and payloads."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from lieid_casadi.comparison import Comparison
from lieid_casadi.identification import Fit
from lieid_casadi.report.page import Section, render
from lieid_casadi.report.sections import (
    dependence_section,
    descriptions_section,
    effects_section,
    errors_section,
    evidence_section,
    finding_section,
    largest_errors_section,
    links_section,
    payload_picture_section,
    payload_section,
    payload_verdict_section,
    provenance_section,
    simulation_section,
    torques_section,
    training_section,
    unexplained_section,
    verdict_section,
    warnings_section,
    waterfall_section,
)

if TYPE_CHECKING:
    from lieid_casadi.diagnosis import Diagnosis
    from lieid_casadi.payload import PayloadEstimate
    from lieid_casadi.simulation import WindowDrift


def comparison_report(fit: Fit, comparison: Comparison, drift: WindowDrift | None = None) -> str:
    """Return the HTML report of a fit on test recordings.

    The verdict comes first, then warnings, errors and figures, then the details of the fit.

    Parameters
    ----------
    fit : Fit
    comparison : Comparison
    drift : WindowDrift, optional
        Errors of a simulation, shown beside the torque errors.
    """
    return render(
        f"{fit.model.robot.name}: model and measurement",
        [
            *comparison_sections(fit, comparison, drift),
            *fit_sections(fit),
            provenance_section(fit, comparison),
        ],
    )


def fit_report(fit: Fit) -> str:
    """Return the HTML report of a fit that has not been tested."""
    return render(
        f"{fit.model.robot.name}: identified model",
        [warnings_section(fit.warnings), *fit_sections(fit), provenance_section(fit)],
    )


def diagnosis_report(diagnosis: Diagnosis, comparison: Comparison | None = None) -> str:
    """Return the HTML report of a diagnosis; with a comparison of its last fit, that too."""
    fit = diagnosis.fit
    sections = [
        finding_section(diagnosis),
        waterfall_section(diagnosis),
        evidence_section(diagnosis),
        warnings_section(diagnosis.warnings),
    ]
    if diagnosis.unexplained:
        sections.insert(3, unexplained_section(diagnosis))
    if comparison is not None:
        sections += [torques_section(comparison), dependence_section(comparison)]
    named = [step.effect for step in diagnosis.steps]
    named += [c.placement.effect.label for s in diagnosis.steps for c, _ in s.indistinguishable]
    return render(
        f"{fit.model.robot.name}: diagnosis",
        [*sections, *fit_sections(fit, named=named), provenance_section(fit, comparison)],
    )


def payload_report(fit: Fit, payload: PayloadEstimate) -> str:
    """Return the HTML report of a payload."""
    return render(
        f"{payload.robot}: payload",
        [
            payload_verdict_section(payload),
            payload_section(payload),
            payload_picture_section(payload),
            warnings_section(payload.warnings, fit.warnings),
            *fit_sections(fit),
            provenance_section(fit, loaded=payload.recordings),
        ],
    )


def comparison_sections(
    fit: Fit, comparison: Comparison, drift: WindowDrift | None = None
) -> list[Section]:
    """Return the sections of a comparison.

    Parameters
    ----------
    fit : Fit
    comparison : Comparison
    drift : WindowDrift, optional
        Errors of a simulation.
    """
    return [
        verdict_section(comparison),
        warnings_section(comparison.warnings, fit.warnings),
        errors_section(comparison),
        *([] if drift is None else [simulation_section(drift)]),
        torques_section(comparison),
        dependence_section(comparison),
        largest_errors_section(comparison),
    ]


def fit_sections(fit: Fit, *, named: Sequence[str] = ()) -> list[Section]:
    """Return the sections of a fit; ``named`` are further effects to describe."""
    sections = [training_section(fit), effects_section(fit), links_section(fit)]
    sections = [section for section in sections if section.data.get("rows") != []]
    return [
        *sections,
        descriptions_section([*named, *(p.effect.label for p in fit.model.placements)]),
    ]
