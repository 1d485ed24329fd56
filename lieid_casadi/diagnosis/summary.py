"""Tables of a diagnosis."""

from __future__ import annotations

from lieid_casadi.comparison.comparison import percent
from lieid_casadi.diagnosis.findings import MOST_RIVALS, findings
from lieid_casadi.diagnosis.result import Diagnosis
from lieid_casadi.diagnosis.step import Step
from lieid_casadi.tables import Table, make_table


def evidence_table(d: Diagnosis) -> Table:
    """Return errors without and with each step, status, rivals and evidence."""
    steps = [step for group in findings(d.steps) for step in group]
    error = "held-out error" if d.mode == "missing" else "error"
    columns: dict[str, list[object]] = {
        "effect": [step.label for step in steps],
        "status": [step.status.replace("_", " ") for step in steps],
        f"{error}, N·m": [_errors(step) for step in steps],
        "falls by": [percent(step.part) for step in steps],
        "on the test by, N·m": [step.fall.test for step in steps],
        "of torque": [percent(step.share) for step in steps],
        "gain / its error": [step.evidence.deviations for step in steps],
        "selected": [percent(step.evidence.selected) for step in steps],
        "fits as well": [_rival_text(step) for step in steps],
    }
    if not any(step.fall.test is not None for step in steps):
        del columns["on the test by, N·m"]
    note = (
        "Errors are those of the final model without the effect and with it. Gain: mean fall of "
        "the error of stretches of time that the choice did not see. Selected: in paths without "
        "one of these stretches. exact: no data can separate the two; data: these data cannot."
    )
    rows = list(zip(*columns.values(), strict=True))
    return make_table("Found" if rows else "Nothing found", list(columns), rows, note=note)


def _errors(step: Step) -> str:
    where = "" if step.joints else f" (joint {step.joint + 1})"
    return f"{step.before:.3g} → {step.after:.3g}{where}"


def _rival_text(step: Step) -> str | None:
    return ", ".join(f"{r.label} ({r.kind})" for r in step.rivals[:MOST_RIVALS]) or None


def unexplained_table(d: Diagnosis) -> Table:
    """Return the joints whose error neither effects nor smooth functions lower."""
    return make_table(
        "Unexplained",
        ("joint", "error over noise", "part of the residual's variance", "not added"),
        [
            (
                f"{u.joint + 1}",
                u.ratio,
                f"{100 * u.fraction:.0f} %",
                "; ".join(f"{label}: {why}" for label, why in u.candidates) or None,
            )
            for u in d.unexplained
        ],
    )


def rejected_table(d: Diagnosis) -> Table:
    """Return the candidates that were selected and not added, and why."""
    return make_table(
        f"Not added ({d.tried} candidates were tried)",
        ("candidate", "reason"),
        list(d.rejected),
        note=alias_sentence(d),
    )


def alias_sentence(d: Diagnosis) -> str:
    """Return which effects this diagnosis cannot name."""
    parts = []
    if d.absorbed:
        parts.append(
            "Not identifiable from any recording, because parameters of the model have the same "
            f"effect: {', '.join(d.absorbed)}."
        )
    if d.weak:
        named = ", ".join(f"{label} ({100 * part:.1f} %)" for label, part in d.weak)
        parts.append(
            "Hardly identifiable from these recordings (part of the effect that differs from the "
            f"model): {named}."
        )
    return " ".join(parts)
