"""Reports of fits, comparisons, diagnoses and payloads."""

from __future__ import annotations

import inspect
import math
import platform
import shlex
from collections.abc import Iterable, Sequence
from importlib.metadata import PackageNotFoundError, version
from typing import Any

import numpy as np
from markupsafe import Markup

import lieid_casadi as lieid
from lieid_casadi.comparison import Comparison
from lieid_casadi.comparison.comparison import (
    BEYOND_NOISE,
    error_table,
    fall_sentence,
    largest_errors_table,
    verdict,
)
from lieid_casadi.diagnosis.extend import Extension
from lieid_casadi.diagnosis.result import (
    evidence_table,
    motion_table,
    rejected_table,
    unexplained_table,
)
from lieid_casadi.effects import make
from lieid_casadi.effects.description import describe, formula_html
from lieid_casadi.effects.registry import REGISTER
from lieid_casadi.errors import LieidWarning, warning_list
from lieid_casadi.identification import Fit
from lieid_casadi.identification.recording_checks import Source
from lieid_casadi.payload.estimate import not_identified
from lieid_casadi.report.page import Section, picture_section, render, table_section
from lieid_casadi.tables import Table, figures, make_table, std_text, value_text

SIGNIFICANT = 2.0  # standard deviations away from zero


def comparison_report(fit: Fit, comparison: Comparison) -> str:
    """Return the HTML report of a fit on test recordings."""
    sections = [
        table_section("", sentences=[verdict(comparison)]),
        *_next_commands(_after_comparison(fit, comparison)),
        _warnings(comparison.warnings, fit.warnings),
        table_section("Error per joint", error_table(comparison)),
    ]
    sections += _pictures(comparison)
    sections.append(table_section("Largest errors", largest_errors_table(comparison), folded=True))
    sections += [*fit_sections(fit), _provenance(fit, comparison)]
    return render(f"{fit.model.robot.name}: model and measurement", sections)


def fit_report(fit: Fit) -> str:
    """Return the HTML report of a fit that has not been tested."""
    return render(
        f"{fit.model.robot.name}: identified model",
        [_warnings(fit.warnings), *fit_sections(fit), _provenance(fit)],
    )


def diagnosis_report(diagnosis: lieid.Diagnosis, comparison: Comparison | None = None) -> str:
    """Return the HTML report of a diagnosis; with a comparison of its last fit, that too."""
    fit, sentences = diagnosis.fit, diagnosis.sentences
    summary = diagnosis.summary
    sentences = [summary, *sentences] if summary else sentences
    errors = diagnosis.error_table()
    evidence = table_section(
        "Evidence",
        evidence_table(diagnosis),
        unexplained_table(diagnosis),
        rejected_table(diagnosis),
        titles=True,
        links=anchors(step.label.partition(":")[0] for step in diagnosis.steps),
        text={"rivals", "reason", "not added"},
    )
    named = [step.label.partition(":")[0] for step in diagnosis.steps]
    named += [rival.effect for step in diagnosis.steps for rival in step.rivals]
    return render(
        f"{fit.model.robot.name}: diagnosis",
        [
            table_section(
                "Verdict", errors, motion_table(diagnosis), sentences=sentences, titles=True
            ),
            *_next_commands(_after_diagnosis(diagnosis)),
            picture_section("From the first model to the last", diagnosis.plot()),
            evidence,
            _warnings(diagnosis.warnings),
            *([] if comparison is None else _pictures(comparison)),
            *fit_sections(fit, named=named),
            _provenance(fit, comparison),
        ],
    )


def experiment_report(result: lieid.Experiment) -> str:
    """Return the HTML report of an experiment: round by round, then the last diagnosis."""
    sections = [
        table_section("Result", result.table(), sentences=result.sentences),
        picture_section("From round to round", result.plot()),
    ]
    for each in result.rounds:
        motion = (
            [("motion for", each.purpose.why), ("design", each.promise)] if each.purpose else []
        )
        facts = [
            *motion,
            ("seconds of motion", f"{each.seconds:.3g}"),
            ("open after it", "; ".join(" or ".join(group) for group in each.open) or "nothing"),
            ("doubts", " ".join(each.warnings) or "none"),
            ("checked", "; ".join(each.checked)),
            ("not checked", "; ".join(each.unchecked)),
        ]
        title = f"Recording {each.number}" if each.purpose else "Given recordings"
        sections.append(table_section(title, sentences=each.sentences, facts=facts))
    found = result.diagnosis
    if found is not None:
        sections.append(table_section("Last diagnosis", found.error_table()))
        sections.append(table_section("Evidence", evidence_table(found)))
    return render(f"{result.robot}: experiment", sections)


def extension_report(extension: Extension) -> str:
    """Return the HTML report of a fit to which effects were added."""
    fit, (before, after) = extension.after, extension.held_out
    sentence = fall_sentence(before, after, np.full(len(before), np.nan))
    note = "RMS error in motion, before and after both models were fitted to the same recordings."
    added = [label.partition(":")[0] for label in extension.added]
    return render(
        f"{fit.model.robot.name}: model with {', '.join(extension.added)}",
        [
            table_section("", *extension_tables(extension), sentences=[sentence], titles=True),
            *_next_commands([("use it in a controller", "lieid export fit2.json --to c -o code")]),
            picture_section("Error per joint", extension.plot(), note),
            _warnings(fit.warnings),
            *fit_sections(fit, named=added),
            _provenance(fit),
        ],
    )


def extension_tables(extension: Extension) -> tuple[Table, Table]:
    """Return errors per joint before and after, and the new parameters."""
    held_out = "cross-validated" if extension.rms_test is None else "test"
    columns = ["joint", f"{held_out} in motion", "after", "%"]
    pairs = [extension.held_out, extension.rms_train]
    if extension.rms_test_at_rest is not None:
        columns += ["at rest", "after", "%"]
        pairs.insert(1, extension.rms_test_at_rest)
    columns += ["train", "after", "%"]
    rows: list[list[object]] = []
    for j, joint in enumerate(extension.after.model.robot.joints):
        row: list[object] = [f"{j + 1} {joint.name}"]
        for pair in pairs:
            before, after = float(pair[0][j]), float(pair[1][j])
            change = 100.0 * (after / before - 1.0)
            row += [figures(before), figures(after)]
            row.append(None if math.isnan(change) else f"{change:+.1f}")
        rows.append(row)
    parameters = make_table(
        "New parameters",
        ["parameter", "value", "std", "unit"],
        [
            [r["expression"], value_text(r["value"], r["std"]), std_text(r["std"]), r["unit"]]
            for r in extension.parameters
        ],
    )
    errors = make_table(f"RMS error, N·m, with {', '.join(extension.added)}", columns, rows)
    return errors, parameters


def premises_report(robot: lieid.Robot, found: lieid.PremiseCheck) -> str:
    """Return the HTML report of a check of premises."""
    sentences = [found.sentence, *(finding.sentence for finding in found.findings)]
    check = "lieid check ROBOT REC "
    remedies = [
        (f"correct {f.premise}", check * f.remedy.startswith("--") + f.remedy)
        for f in found.findings
        if f.remedy
    ]
    wrong = {finding.premise for finding in found.findings}
    results: dict[str, list[str]] = {}
    for name in found.checked:
        results[name] = ["see above" if name in wrong else "nothing wrong was found"]
    for name, why in found.not_checkable:
        results.setdefault(name, []).append(f"not checked: {why}")
    rows = [(name, "; ".join(results[name])) for name in sorted(results)]
    use = [("fit a model", "lieid identify ROBOT REC -o fit.json")] if not wrong else []
    return render(
        f"{robot.name}: premises",
        [
            table_section("", found.table, sentences=sentences, titles=True),
            *_next_commands(remedies or use),
            table_section(
                "Tested", make_table("", ("premise", "result"), rows), text={"premise", "result"}
            ),
        ],
    )


def _next_commands(commands: list[tuple[str, str]]) -> list[Section]:
    """Return what to do next: purposes and commands."""
    return [table_section("What to do next", facts=commands)] if commands else []


def _after_comparison(fit: Fit, comparison: Comparison) -> list[tuple[str, str]]:
    if not np.any(np.nan_to_num(comparison.over_noise) > BEYOND_NOISE):
        return [("use the model", "lieid export FIT --to c -o code")]
    names = [
        [s.name or "REC" for s in part]
        for part in (fit.provenance.recordings, comparison.recordings)
    ]
    words = ["lieid", "diagnose", "FIT", "--train", *names[0], "--test", *names[1]]
    return [("search for missing effects", shlex.join(words))]


def _after_diagnosis(diagnosis: lieid.Diagnosis) -> list[tuple[str, str]]:
    """Return the commands that separate rivals, fit or find the final model, and use it."""
    found = []
    for step in diagnosis.steps:
        if step.status == "one_of" and step.rivals:
            words = shlex.join([step.label, step.rivals[0].label])
            command = f"lieid discriminate FIT {words} -o motion"
            found.append((f"separate {step.label} from its rivals", command))
    train, test = ([s.name or "REC" for s in part] for part in (diagnosis.train, diagnosis.test))
    tested, effects = ["--test", *test] * bool(test), ",".join(diagnosis.fit.model.effects)
    if diagnosis.steps and diagnosis.mode == "changed":
        again = ["lieid", "diagnose", "ROBOT", "--train", *test, "-o", "fit.json"]
        found.append(("find the model of the arm as it is now", shlex.join(again)))
    elif diagnosis.steps:
        again = ["lieid", "identify", "ROBOT", *train, *tested]
        again += ["--effects", effects, "--method", diagnosis.fit.method]
        again += ["--cutoff", f"{diagnosis.fit.processing.cutoff:.6g}", "-o", "fit.json"]
        found.append(("fit the model with these effects", shlex.join(again)))
    if diagnosis.steps or diagnosis.verdict == "sufficient":
        fit = "fit.json" if diagnosis.steps else "FIT"
        found.append(("use it in a controller", f"lieid export {fit} --to c -o code"))
    return found


def payload_report(fit: Fit, payload: lieid.PayloadEstimate) -> str:
    """Return the HTML report of a payload."""
    note = (
        "RMS error in motion, measured and predicted through the same filter: with the fit alone, "
        "and with the payload added."
    )
    excite = [("move the payload so that all of it acts", "lieid excite FIT -o motion")]
    return render(
        f"{payload.robot}: payload",
        [
            table_section("", sentences=[payload.sentence]),
            _payload(payload),
            *_next_commands(excite if payload.not_identified else []),
            picture_section("Error per joint", payload.plot(), note),
            _warnings(payload.warnings, fit.warnings),
            *fit_sections(fit),
            _provenance(fit, loaded=payload.recordings),
        ],
    )


def fit_sections(fit: Fit, *, named: Sequence[str] = ()) -> list[Section]:
    """Return the sections of a fit; ``named`` are further effects to describe."""
    rows = fit.parameter_table()
    effects = [row for row in rows if "." in row["name"]]
    links = [row for row in rows if "." not in row["name"]]
    return [
        _training(fit),
        *([_parameters("Effects", effects)] if effects else []),
        *([_parameters("Base parameters of the links", links, folded=True)] if links else []),
        _descriptions([*named, *(p.effect.label for p in fit.model.placements)]),
    ]


def anchors(labels: Iterable[str]) -> dict[str, str]:
    """Return effect → anchor of its description in the page; unregistered ones are left out."""
    return {label: f"effect-{label.replace('/', '-')}" for label in labels if label in REGISTER}


def _warnings(warnings: Sequence[LieidWarning], of_fit: Sequence[LieidWarning] = ()) -> Section:
    """Return the warnings of a result, and those of the fit that it uses."""
    groups = [
        {"title": title, "warnings": warning_list(group)}
        for title, group in (("", warnings), ("Warnings of the fit", of_fit))
        if group
    ]
    return Section("Warnings", "warnings.html", {"groups": groups})


def _pictures(comparison: Comparison) -> list[Section]:
    """Return torque and error over time, and the error over the signals that it may depend on."""
    note = (
        "Mean error over position, speed, direction, load and time. A line at zero shows no "
        "dependence. The same curve in both directions indicates gravity, inertia or a spring. "
        "A difference between the directions that grows with speed indicates viscous friction; "
        "with load, load-dependent friction; with position, position-dependent friction."
    )
    return [
        picture_section("Torque over time", comparison.plot()),
        picture_section("Dependence of the error on signals", comparison.plot_errors(), note),
    ]


def _training(fit: Fit) -> Section:
    """Return the errors of training and cross-validation, and the conditioning of the fit."""
    columns = (fit.rms_cv, fit.rms_train, fit.rms_train_raw)
    rows = []
    for j, joint in enumerate(fit.model.robot.joints):
        errors = (figures(values[j]) for values in columns)
        rows.append((f"{j + 1} {joint.name}", *errors, "N·m" if joint.revolute else "N"))
    headings = ("joint", "cross-validated, in motion", "all", "raw", "unit")
    note = "Cross-validated: on blocks left out, joints in motion. All, raw: errors of training."
    facts = [
        ("effects", ", ".join(fit.model.effects) or "none"),
        ("method", fit.method),
        ("base parameters", str(fit.model.base.count)),
        ("condition number", f"{fit.conditioning.condition_number:.3g}"),
        ("physically consistent", "yes" if fit.physically_consistent else "no"),
    ]
    return table_section("Training", make_table("", headings, rows, note=note), facts=facts)


def _parameters(title: str, rows: list[dict[str, Any]], *, folded: bool = False) -> Section:
    """Return identified parameters with their standard deviations."""
    weak = [row["std"] is None or abs(row["value"]) < SIGNIFICANT * row["std"] for row in rows]
    cells = [
        (
            str(row["joint"]),
            row["name"],
            value_text(row["value"], row["std"]),
            std_text(row["std"]),
            row["unit"],
            _meaning(row),
        )
        for row in rows
    ]
    headings = ("joint", "name", "value", "std", "unit", "combination")
    shown = len(headings) - (not any(row[-1] for row in cells))
    note = "Grey: within two standard deviations of zero, or without a standard deviation."
    rows_shown = [row[:shown] for row in cells]
    table = make_table("", headings[:shown], rows_shown, note=note if any(weak) else "")
    text = {"name", "unit", "combination"}
    return table_section(title, table, text=text, weak=weak, folded=folded)


def _meaning(row: dict[str, Any]) -> str:
    """Return the combination that a parameter is; empty if that is its name."""
    name, joint, expression = row["name"], row["joint"], str(row["expression"])
    return "" if expression in (name, f"{name}{joint}", f"{name}:{joint}") else expression


def effect_page(label: str) -> str:
    """Return the page of a registered effect: what it is, its facts, and the effects like it."""
    effect = make(label)
    words = inspect.cleandoc(type(effect).__doc__ or "").partition("\n\n")[0].replace("`", "")
    facts = [_fact(*fact) for fact in describe(effect)]
    sections = [table_section("", sentences=[" ".join(words.split())], facts=facts)]
    if rivals := [name for name in effect.confused_with if name in REGISTER]:
        sections.append(_descriptions(rivals, title="Effects that it can be confused with"))
    return render(label, sections)


def _descriptions(labels: Iterable[str], *, title: str = "Effects in this report") -> Section:
    """Return the descriptions of effects: formula, coefficients, rivals, and what reveals them."""
    effects = [
        {"label": label, "anchor": anchor, "facts": [_fact(*f) for f in describe(make(label))]}
        for label, anchor in anchors(dict.fromkeys(labels)).items()
    ]
    return Section(title, "effects.html", {"effects": effects}, folded=True)


def _fact(name: str, text: str) -> tuple[str, str]:
    return name, Markup(formula_html(text)) if name == "formula" else text


def _payload(payload: lieid.PayloadEstimate) -> Section:
    """Return the table of quantities, and those that cannot be identified."""
    rows = payload.table()
    parts = not_identified(payload)
    note = (
        "In the tool frame, inertia about the centre of mass. The standard deviations include "
        "the fit's own uncertainty."
    )
    note += " Grey: not identifiable from this recording." if parts else ""
    return table_section(
        "Payload",
        make_table("", ("", "value", "std", "95 % from", "to", "unit"),
                   map(_payload_row, rows), note=note),
        notes=[f"{names}: {reason}." for names, reason in parts],
        text={"", "unit"},
        weak=[not row["identified"] for row in rows],
    )  # fmt: skip


def _payload_row(row: dict[str, Any]) -> tuple[object, ...]:
    value, std, interval = row["value"], row["std"], row["interval"] or (None, None)
    ends = [None if end is None else value_text(end, std) for end in interval]
    return (
        row["name"],
        None if value is None else value_text(value, std),
        std_text(std),
        *ends,
        row["unit"],
    )


def _provenance(
    fit: Fit, comparison: Comparison | None = None, *, loaded: Sequence[Source] = ()
) -> Section:
    """Return versions, and names and hashes of all recordings."""
    sources = [("training", source) for source in fit.provenance.recordings]
    if comparison is not None:
        sources += [("test", source) for source in comparison.recordings]
    sources += [("with payload", source) for source in loaded]
    facts = [
        ("robot", fit.model.robot.name),
        ("fitted with lieid-casadi", fit.provenance.version),
        ("cut-off", f"{fit.processing.cutoff:.4g} Hz"),
        ("Python", platform.python_version()),
        *((name, _version(name)) for name in ("casadi", "numpy", "scipy")),
    ]
    headings = ("use", "recording", "sha256")
    rows = [(use, source.name or None, source.sha256 or None) for use, source in sources]
    table = make_table("", headings, rows)
    return table_section("Provenance", table, facts=facts, text=headings, folded=True)


def _version(name: str) -> str:
    try:
        return version(name)
    except PackageNotFoundError:
        return "unknown"
