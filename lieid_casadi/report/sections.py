"""Sections of reports, each a template with its data."""

from __future__ import annotations

import math
import platform
from collections.abc import Iterable, Sequence
from importlib.metadata import PackageNotFoundError, version
from typing import TYPE_CHECKING, Any

import numpy as np

from lieid_casadi.comparison import Comparison
from lieid_casadi.comparison.comparison import digits, error_table, largest_errors_table, verdict
from lieid_casadi.diagnosis import text_summary
from lieid_casadi.effects import make
from lieid_casadi.effects.description import describe
from lieid_casadi.effects.registry import REGISTER
from lieid_casadi.errors import LieidWarning, warning_list
from lieid_casadi.identification import Fit
from lieid_casadi.identification.recording_checks import Source
from lieid_casadi.payload.view import not_identified
from lieid_casadi.report.page import Section, data_uri, table_section
from lieid_casadi.simulation import WindowDrift
from lieid_casadi.simulation.view import window_table
from lieid_casadi.tables import make_table

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from lieid_casadi.diagnosis import Diagnosis
    from lieid_casadi.payload import PayloadEstimate


def verdict_section(comparison: Comparison) -> Section:
    """Return the sentence at the beginning of a report."""
    return Section("", "verdict.html", {"sentence": verdict(comparison)})


def warnings_section(
    warnings: Sequence[LieidWarning], of_fit: Sequence[LieidWarning] = ()
) -> Section:
    """Return the warnings of a result, and those of the fit that it uses."""
    groups = [
        {"title": title, "warnings": warning_list(group)}
        for title, group in (("", warnings), ("Warnings of the fit", of_fit))
        if group
    ]
    return Section("Warnings", "warnings.html", {"groups": groups})


def errors_section(comparison: Comparison) -> Section:
    """Return the errors, one row per joint, with bars in proportion to the relative error."""
    table = error_table(comparison)
    parts = np.nan_to_num(np.clip(comparison.relative_rms_moving, 0.0, 1.0))
    longest = max(float(parts.max()), 1e-12)
    data = {
        "table": table,
        "bars": [round(100.0 * float(part) / longest, 1) for part in parts],
        "bar_column": table.headings.index("of torque"),
    }
    return Section("Error per joint", "errors.html", data)


def largest_errors_section(comparison: Comparison) -> Section:
    """Return the samples with the largest errors of every joint."""
    return table_section("Largest errors", largest_errors_table(comparison), folded=True)


def torques_section(comparison: Comparison) -> Section:
    """Return measured and predicted torque and the error over time."""
    return picture_section("Torque over time", comparison.plot(), "")


def dependence_section(comparison: Comparison) -> Section:
    """Return the error over the signals on which it may depend."""
    note = (
        "Mean error over position, speed, direction, load and time. A line at zero shows no "
        "dependence. The same curve in both directions indicates gravity, inertia or a spring. "
        "A difference between the directions that grows with speed indicates viscous friction; "
        "with load, load-dependent friction; with position, position-dependent friction."
    )
    return picture_section("Dependence of the error on signals", comparison.plot_errors(), note)


def picture_section(title: str, figure: Figure, note: str) -> Section:
    """Return a section of one figure.

    Parameters
    ----------
    title : str
    figure : Figure
        Embedded as PNG.
    note : str
        Explanation, shown before the figure; may be empty.
    """
    return Section(title, "picture.html", {"uri": data_uri(figure), "alt": title, "note": note})


def training_section(fit: Fit) -> Section:
    """Return the errors of training and cross-validation, and the conditioning of the fit."""
    columns = (fit.rms_cv, fit.rms_train, fit.rms_train_raw)
    table = make_table(
        "",
        ("joint", "cross-validated, in motion", "all", "raw", "unit"),
        [
            (
                f"{j + 1} {joint.name}",
                *(digits(values[j]) for values in columns),
                "N·m" if joint.revolute else "N",
            )
            for j, joint in enumerate(fit.model.robot.joints)
        ],
        note="Cross-validated: on blocks left out of the fit, joints in motion. "
        "All, raw: errors of training.",
    )
    facts = [
        ("effects", ", ".join(fit.model.effects) or "none"),
        ("method", fit.method),
        ("base parameters", str(fit.model.base.count)),
        ("condition number", f"{fit.conditioning.condition_number:.3g}"),
        ("physically consistent", "yes" if fit.physically_consistent else "no"),
    ]
    return table_section("Training", table, facts=facts)


SIGNIFICANT = 2.0  # standard deviations away from zero


def effects_section(fit: Fit) -> Section:
    """Return coefficients and shape parameters of the effects."""
    return _section("Effects", fit, [row for row in fit.parameter_table() if "." in row["name"]])


def links_section(fit: Fit) -> Section:
    """Return the base parameters of the links."""
    rows = [row for row in fit.parameter_table() if "." not in row["name"]]
    return _section("Base parameters of the links", fit, rows, folded=True)


def _section(title: str, fit: Fit, table: list[dict[str, Any]], *, folded: bool = False) -> Section:
    rows = [
        {
            "joint": row["joint"],
            "name": row["name"],
            "expression": _meaning(row),
            "value": value_text(row["value"], row["std"]),
            "std": "–" if row["std"] is None else f"{row['std']:#.2g}".rstrip("."),
            "unit": row["unit"],
            "weak": row["std"] is None or abs(row["value"]) < SIGNIFICANT * row["std"],
        }
        for row in table
    ]
    data = {
        "rows": rows,
        "weak": any(row["weak"] for row in rows),
        "combined": any(row["expression"] for row in rows),
    }
    return Section(title, "parameters.html", data, folded=folded)


def _meaning(row: dict[str, Any]) -> str:
    """Return the combination that a parameter is; empty if that is its name."""
    name, joint, expression = row["name"], row["joint"], str(row["expression"])
    return "" if expression in (name, f"{name}{joint}", f"{name}:{joint}") else expression


def value_text(value: float, std: float | None) -> str:
    """Return a value to the second digit of its standard deviation.

    Examples
    --------
    >>> value_text(12.3456, 0.021)
    '12.346'
    >>> value_text(12.3456, None)
    '12.35'
    """
    if not std:
        return f"{value:.4g}"
    decimals = 1 - math.floor(math.log10(std))
    return f"{value:z.{decimals}f}" if 0 <= decimals <= 8 else f"{value:.4g}"


def simulation_section(drift: WindowDrift) -> Section:
    """Return how far the simulated motion leaves the measured one, or why it is not simulated."""
    sentences = [f"Not simulated: {drift.reason}."] if drift.reason else []
    return table_section("Simulation error per joint", window_table(drift), sentences=sentences)


def anchors(labels: Iterable[str]) -> dict[str, str]:
    """Return effect → anchor of its description in the page."""
    return {label: f"effect-{label.replace('/', '-')}" for label in labels if label in REGISTER}


def descriptions_section(labels: Iterable[str]) -> Section:
    """Return the descriptions of effects: formula, coefficients, rivals, and what reveals them.

    Parameters
    ----------
    labels : iterable of str
        Names, with options; those that are not registered are left out.
    """
    effects = [
        {"label": label, "anchor": anchor, "facts": describe(make(label))}
        for label, anchor in anchors(dict.fromkeys(labels)).items()
    ]
    return Section("Effects in this report", "effects.html", {"effects": effects}, folded=True)


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


def payload_verdict_section(payload: PayloadEstimate) -> Section:
    """Return the answer in one sentence."""
    note = ""
    if payload.friction:
        note = "Coulomb and viscous friction and offsets were identified again from the loaded run."
    return Section("", "verdict.html", {"sentence": payload.sentence, "note": note})


def payload_section(payload: PayloadEstimate) -> Section:
    """Return the table of quantities, and those that cannot be identified."""
    rows = []
    for row in payload.table():
        value, std, interval = row["value"], row["std"], row["interval"] or (None, None)
        cells = ["–" if value is None else value_text(value, std)]
        cells += ["–" if std is None else f"{std:.2g}"]
        cells += ["–" if end is None else f"{end:.4g}" for end in interval]
        cells += [f"{row['feasible']:.4g}"]
        rows.append({**row, "cells": cells})
    parts = [{"names": names, "reason": reason} for names, reason in not_identified(payload)]
    return Section("Payload", "payload.html", {"rows": rows, "parts": parts})


def payload_picture_section(payload: PayloadEstimate) -> Section:
    """Return the error of each joint with and without the payload."""
    note = (
        "RMS error in motion, measured and predicted through the same filter: with the fit alone, "
        "and with the payload added and nothing else changed."
    )
    return picture_section("Error per joint", payload.plot(), note)


def provenance_section(
    fit: Fit, comparison: Comparison | None = None, *, loaded: Sequence[Source] = ()
) -> Section:
    """Return versions, and names and hashes of all recordings.

    Parameters
    ----------
    fit : Fit
    comparison : Comparison, optional
        Its recordings are listed as tests.
    loaded : sequence of Source
        Recordings with a payload.
    """
    sources = [("training", source) for source in fit.provenance.recordings]
    if comparison is not None:
        sources += [("test", source) for source in comparison.recordings]
    sources += [("with payload", source) for source in loaded]
    data = {
        "facts": [
            ("robot", fit.model.robot.name),
            ("fitted with lieid-casadi", fit.provenance.version),
            ("cut-off", f"{fit.processing.cutoff:.4g} Hz"),
            ("Python", platform.python_version()),
            *((name, _version(name)) for name in ("casadi", "numpy", "scipy")),
        ],
        "sources": [(use, source.name or "–", source.sha256 or "–") for use, source in sources],
    }
    return Section("Provenance", "provenance.html", data, folded=True)


def _version(name: str) -> str:
    try:
        return version(name)
    except PackageNotFoundError:
        return "unknown"
