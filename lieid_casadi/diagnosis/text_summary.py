"""A diagnosis in sentences and tables."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from lieid_casadi.comparison.comparison import percent
from lieid_casadi.comparison.noise_floor import SOURCES
from lieid_casadi.diagnosis.findings import MOST_RIVALS, findings, grouped, location
from lieid_casadi.diagnosis.wording import join_words
from lieid_casadi.effects.registry import REGISTER, make
from lieid_casadi.tables import Table, make_table
from lieid_casadi.tables import html as to_html

if TYPE_CHECKING:
    from lieid_casadi.diagnosis.diagnosis import Diagnosis
    from lieid_casadi.diagnosis.diagnosis_step import DiagnosisStep
    from lieid_casadi.diagnosis.residual.unexplained import Unexplained
    from lieid_casadi.diagnosis.search.search_results import Difference

SMALLEST_LOG10_P = -15  # of a p-value that is shown; smaller ones depend on the tail's model alone


def sentence(d: Diagnosis) -> str:
    """Return the verdict as a paragraph: findings, and the unexplained residual."""
    return " ".join(sentences(d))


def sentences(d: Diagnosis) -> list[str]:
    """Return the verdict, one sentence for each finding and each unexplained part."""
    parts = [*(event.sentence for event in d.events), *findings(d)]
    if d.verdict == "sufficient" and d.mode == "missing":
        parts.append("No effect of the library improves the model significantly.")
    elif d.verdict == "sufficient":
        parts.append("Nothing has changed significantly since the fit.")
    if d.limits_reached:
        parts.append(
            f"The search ended at its limit ({join_words(d.limits_reached)}); "
            "further effects may be missing."
        )
    parts += difference_sentences(d.differing)
    return parts + [residual_sentence(part) for part in d.unexplained]


def difference_sentences(differing: Sequence[Difference]) -> list[str]:
    """Return one sentence for each effect that differs between the training recordings."""
    found = []
    for label in dict.fromkeys(difference.label for difference in differing):
        own = [difference for difference in differing if difference.label == label]
        where, names = location(own[0].joints), join_words([n for d in own for n in d.recordings])
        if own[0].is_change:
            what = f"is not the same in {names} as in the others ({_values(own[0])} more)"
        elif len(own) == 1:
            what = f"would explain {names} and not the others"
        else:
            values = [f"{_values(each)} in {join_words(each.recordings)}" for each in own]
            what = f"has other values in each of them ({', '.join(values)})"
        found.append(
            f"The training recordings differ from each other: {own[0].effect} on {where} {what}"
            + ("." if own[0].is_change else ", so it is not an effect of the arm.")
        )
    return found


def _values(difference: Difference) -> str:
    """Return the coefficients of a difference with units."""
    units = {}
    if difference.effect in REGISTER:
        units = {c.name: c.unit for c in make(difference.effect).coefficients}
    texts = [f"{k} = {v:.3g} {units.get(k, '')}" for k, v in difference.parameters.items()]
    return join_words([text.strip().replace("-", "−") for text in texts])


def residual_sentence(part: Unexplained) -> str:
    """Return what the error of a joint follows, with its formula or the nearest effects."""
    text = f"On joint {part.joint + 1}, {part.relation}"
    if part.contained_in:
        (reason,) = [c.reason for c in part.candidates if c.label == part.contained_in] or [""]
        because = f": {reason}" if reason else ""
        return f"{text}; {part.contained_in} has this form and was not added{because}."
    text += "; no effect of the library explains it"
    if part.depends_on == ("t",):
        return (
            text + ", and a function of time does not carry over to another recording. Record "
            "again, with temperature if friction may change while the arm warms up."
        )
    if part.formula is not None:
        text += f". It is approximately {part.formula.text} in SI units"
    if part.candidates:
        nearest = part.candidates[0]
        text += f"; the nearest effect, {nearest.label}, explains {100 * nearest.part:.0f} % of it"
    return text + "."


def rerun_options(d: Diagnosis, labels: Sequence[str]) -> str:
    """Return the options that repeat a diagnosis with user-defined effects in a file F.py."""
    if d.mode == "changed":  # the model is kept; registered effects are tried
        return "--effects-file F.py"
    return f"--effects-file F.py --effects '{','.join([*d.fit.model.effects, *labels])}'"


def error_table(d: Diagnosis) -> Table:
    """Return the error of each joint, N·m, one row per model."""
    measured, errors = d.shown
    heading = [f"joint {j + 1}" for j in range(len(d.joint_names))]
    rows: list[list[object]] = [
        [name, *map(float, values)] for name, values in zip(d.model_names, errors, strict=True)
    ]
    reference, values = d.reference
    rows.append([reference, *map(float, values)])
    if d.expected is None:
        source = SOURCES[d.noise_source]
        note = "Each row adds effects to the row above and fits all parameters again."
    else:
        source = "held-out error of the fit"
        note = (
            "The model is kept. Near velocity reversals, where the sign of dry friction is "
            "uncertain, errors count less, in all rows."
        )
    return make_table(
        f"RMS error on the {measured}, N·m (low-pass {d.fit.processing.cutoff:.3g} Hz; "
        f"{reference}: {source})",
        ["model", *heading],
        rows,
        note=note,
    )


def evidence_table(d: Diagnosis) -> Table:
    """Return size, errors, rivals and evidence of each step, the largest share first."""
    steps = [step for group in grouped(d.steps, d.mode) for step in group]
    tested = _test_errors(d)
    columns: dict[str, list[object]] = {
        "effect": [step.label for step in steps],
        "size, N·m": [step.evidence.effect_size for step in steps],
        "of torque": [percent(step.share) for step in steps],
        f"{error_name(d)}, N·m": [_held_out_errors(step) for step in steps],
        "test error, N·m": [tested.get(step.label) for step in steps],
        "fits as well": [_rivals(step) for step in steps],
        "p": [_p_value(step) for step in steps],
    }
    if not tested:
        del columns["test error, N·m"]
    selected = "Steps are selected on the training recordings. " if d.mode == "missing" else ""
    note = (
        "Size: RMS of the torque that the effect explains on its joint; of torque: relative to the "
        f"joint's torque. {selected}exact: no data can separate the two; data: these data cannot. "
        "p: family-wise p-value over all candidates."
    )
    rows = list(zip(*columns.values(), strict=True))
    return make_table("Found" if rows else "Nothing found", list(columns), rows, note=note)


def error_name(d: Diagnosis) -> str:
    """Return what the errors before and after a step are: a kept model is not fitted."""
    return "held-out error" if d.mode == "missing" else "error"


def _held_out_errors(step: DiagnosisStep) -> str:
    """Return the error before and after a step, with its joint if the effect acts on all."""
    e = step.evidence
    where = "" if step.joints else f" (joint {e.joint + 1})"
    return f"{e.held_out_before:.3g} → {e.held_out_after:.3g}{where}"


def _rivals(step: DiagnosisStep) -> str | None:
    """Return the nearest rivals of a step, and the kind of rivalry."""
    nearest = step.indistinguishable[:MOST_RIVALS]
    return ", ".join(f"{c.placement.label} ({kind})" for c, kind in nearest) or None


def _test_errors(d: Diagnosis) -> dict[str, str]:
    """Return the test error of each step's joint before and after it, by label; empty without."""
    if d.mode == "changed" or not d.test:
        return {}
    _, errors = d.shown
    texts: dict[str, str] = {}
    for steps, before, after in zip(d.additions, errors[:-1], errors[1:], strict=True):
        for step in steps:
            joint = step.evidence.joint
            rises = " (rises)" if after[joint] >= before[joint] else ""
            texts[step.label] = f"{before[joint]:.3g} → {after[joint]:.3g}{rises}"
    return texts


def unexplained_table(d: Diagnosis) -> Table:
    """Return the part of each joint's residual that no effect explains."""
    return make_table(
        "Unexplained",
        ("joint", "part of the residual's variance", "depends on", "approximately, N·m",
         "test confirms", "effects that explain part of it, and why they were not added"),
        [
            (
                f"{u.joint + 1}",
                f"{100 * u.fraction:.0f} %",
                ", ".join(u.signals) or "no measured signal",
                None if u.formula is None else u.formula.text,
                {True: "yes", False: "no", None: None}[u.confirmed],
                "; ".join(f"{c.label}: {c.reason}" for c in u.candidates) or None,
            )
            for u in d.unexplained
        ],
        note="Cross-validated.",
    )  # fmt: skip


def rejected_table(d: Diagnosis) -> Table:
    """Return the candidates that were rejected, and why."""
    return make_table(
        f"Rejected ({d.tried} candidates were tried)",
        ("candidate", "reason"),
        list(dict(d.rejected).items()),
        note=d.aliases.sentence,
    )


def _p_value(step: DiagnosisStep) -> str:
    exponent = step.evidence.log10_p
    return f"{10.0**exponent:.2g}" if exponent > SMALLEST_LOG10_P else f"< 1e{SMALLEST_LOG10_P}"


def html(d: Diagnosis) -> str:
    """Return the verdict and the table as HTML."""
    return to_html(sentence(d), error_table(d))
