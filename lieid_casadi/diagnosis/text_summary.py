"""A diagnosis in sentences and tables."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from lieid_casadi.comparison.noise_floor import SOURCES
from lieid_casadi.tables import Table, make_table
from lieid_casadi.tables import html as to_html

if TYPE_CHECKING:
    from lieid_casadi.diagnosis.diagnosis import Diagnosis
    from lieid_casadi.diagnosis.diagnosis_step import DiagnosisStep
    from lieid_casadi.diagnosis.residual.unexplained import Unexplained

SMALLEST_LOG10_P = -15  # of a p-value that is shown; smaller ones depend on the tail's model alone


def location(joints: tuple[int, ...]) -> str:
    """Return ``joint 3``, ``joint 5 from joint 6`` or ``the whole arm`` (joints from 0)."""
    if not joints:
        return "the whole arm"
    if len(joints) == 2:
        return f"joint {joints[0] + 1} from joint {joints[1] + 1}"
    return f"joint {joints[0] + 1}"


def sentence(d: Diagnosis) -> str:
    """Return the verdict: effects with parameters and rivals, and the unexplained residual."""
    parts = []
    if d.steps:
        subject = "The model lacks " if d.mode == "missing" else "Changed since the fit: "
        parts.append(subject + "; ".join(_findings(d.steps, error_name(d))) + ".")
    elif d.verdict == "sufficient" and d.mode == "missing":
        parts.append("No effect of the library improves the model significantly.")
    elif d.verdict == "sufficient":
        parts.append("Nothing has changed significantly since the fit.")
    if d.limits_reached:
        parts.append(
            f"The search ended at its limit ({_and(d.limits_reached)}); further effects may be "
            "missing."
        )
    parts += [_residual_sentence(part) for part in d.unexplained]
    return " ".join(parts)


def error_name(d: Diagnosis) -> str:
    """Return what the errors before and after a step are: a kept model is not fitted."""
    return "held-out error" if d.mode == "missing" else "error"


def _findings(steps: Sequence[DiagnosisStep], error: str) -> list[str]:
    """Return one finding for each effect; steps with one effect on several joints are joined."""
    groups: dict[tuple[str, ...], list[DiagnosisStep]] = {}
    for step in steps:
        together = len(step.joints) == 1 and not step.indistinguishable
        groups.setdefault((step.effect,) if together else (step.label, ""), []).append(step)
    return [_finding(sorted(group, key=lambda s: s.joints), error) for group in groups.values()]


def _finding(steps: Sequence[DiagnosisStep], error: str) -> str:
    """Return effect, joints, parameters, fall of the error, and rivals."""
    first = steps[0]
    rivals = [f"{c.name} on {location(c.joints)}" for c, _ in first.indistinguishable]
    named = f"{first.effect} on {_joined_locations(steps)}"
    fit = "fits" if len(rivals) == 1 else "fit"
    alternatives = f", or {' or '.join(rivals)}, which {fit} as well" if rivals else ""
    values = []
    for name, unit in first.units.items():
        numbers = _and([f"{step.parameters[name]:.3g}" for step in steps])
        values.append(f"{name} = {numbers}" if unit == "1" else f"{name} = {numbers} {unit}")
    falls = _and(
        [
            f"from {step.evidence.held_out_before:.3g} to {step.evidence.held_out_after:.3g}"
            for step in steps
        ]
    )
    return f"{named} ({', '.join(values)}; {error} {falls} N·m){alternatives}"


def _joined_locations(steps: Sequence[DiagnosisStep]) -> str:
    if len(steps) == 1:
        return location(steps[0].joints)
    return f"joints {_and([str(step.joints[0] + 1) for step in steps])}"


def _and(words: Sequence[str]) -> str:
    """Return ``a``, ``a and b`` or ``a, b and c``."""
    return " and ".join([*([", ".join(words[:-1])] if len(words) > 1 else []), words[-1]])


def _residual_sentence(part: Unexplained) -> str:
    text = (
        f"On joint {part.joint + 1}, {100 * part.fraction:.0f} % of the variance of the residual "
        f"depends on {_and(part.depends_on)} and is not explained by any effect of the library"
    )
    if part.formula is None:
        return text + "."
    return f"{text}; it is approximately {part.formula.text} in SI units."


def rerun_options(d: Diagnosis, labels: Sequence[str]) -> str:
    """Return the options that repeat a diagnosis with user-defined effects in a file F.py."""
    if d.mode == "changed":  # the model is kept; registered effects are tried
        return "--effects-file F.py"
    return f"--effects-file F.py --effects '{','.join([*d.fit.model.effects, *labels])}'"


def error_table(d: Diagnosis) -> Table:
    """Return the error of each joint, N·m, one row per model."""
    measured, errors = d.shown
    heading = [f"joint {j + 1}" for j in range(len(d.joint_names))]
    names = ["+".join(d.baseline_effects) or "rigid", *(f"+ {step.label}" for step in d.steps)]
    p_values = [None, *(_p_value(step) for step in d.steps)]
    rows: list[list[object]] = [
        [name, *map(float, values), p]
        for name, values, p in zip(names, errors, p_values, strict=True)
    ]
    if d.expected is not None:
        rows.append(["expected", *map(float, d.expected), None])
    rows.append(["noise floor", *map(float, d.noise_floor), None])
    expected = "" if d.expected is None else " Expected: held-out error of the fit."
    training = " Steps are selected on the training recordings." if d.mode == "missing" else ""
    return make_table(
        f"RMS error on the {measured}, N·m (low-pass {d.fit.processing.cutoff:.3g} Hz)",
        ["model", *heading, "p"],
        rows,
        note="Each row adds one effect to the row above and fits all parameters again. p: "
        f"family-wise p-value over all candidates.{training} "
        f"Noise floor: {SOURCES[d.noise_source]}.{expected}",
    )


def evidence_table(d: Diagnosis) -> Table:
    """Return evidence, parameters and rivals of each step."""
    confirmed = {True: "yes", False: "no", None: None}
    rows = [
        (
            step.effect,
            location(step.joints),
            ", ".join(f"{name} = {value:.4g}" for name, value in step.parameters.items()),
            step.evidence.effect_size,
            f"{step.evidence.held_out_before:.3g} → {step.evidence.held_out_after:.3g}",
            confirmed[step.evidence.confirmed],
            ", ".join(f"{c.placement.label} ({kind})" for c, kind in step.indistinguishable[:3])
            or None,
        )
        for step in d.steps
    ]
    headings = (
        "effect", "on", "parameters", "size, N·m", f"{error_name(d)}, N·m", "test confirms",
        "fits as well",
    )  # fmt: skip
    note = "exact: no data can separate the two; data: these data cannot."
    return make_table("Found" if rows else "Nothing found", headings, rows, note=note)


def unexplained_table(d: Diagnosis) -> Table:
    """Return the part of each joint's residual that no effect explains."""
    return make_table(
        "Unexplained",
        ("joint", "part of the residual's variance", "depends on", "approximately, N·m"),
        [
            (
                f"{u.joint + 1}",
                f"{100 * u.fraction:.0f} %",
                ", ".join(u.depends_on),
                None if u.formula is None else u.formula.text,
            )
            for u in d.unexplained
        ],
        note="Cross-validated.",
    )


def rejected_table(d: Diagnosis) -> Table:
    """Return the candidates that were rejected, and why."""
    return make_table(
        f"Rejected ({d.tried} candidates were tried)",
        ("candidate", "reason"),
        d.rejected,
        note=d.aliases.sentence,
    )


def _p_value(step: DiagnosisStep) -> str:
    exponent = step.evidence.log10_p
    return f"{10.0**exponent:.2g}" if exponent > SMALLEST_LOG10_P else f"< 1e{SMALLEST_LOG10_P}"


def html(d: Diagnosis) -> str:
    """Return the verdict and the table as HTML."""
    return to_html(sentence(d), error_table(d))
