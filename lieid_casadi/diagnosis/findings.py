"""Findings of a diagnosis in plain English, one for each effect: joints, size, rivals."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from lieid_casadi.diagnosis.wording import join_words
from lieid_casadi.effects.registry import REGISTER, make

if TYPE_CHECKING:
    from lieid_casadi.diagnosis.diagnosis import Diagnosis
    from lieid_casadi.diagnosis.diagnosis_step import DiagnosisStep
    from lieid_casadi.effects import Effect

LEAST_SELECTED = 0.8  # of the repetitions; below it a finding is stated with its rivals
MOST_RIVALS = 3  # named in a sentence; the JSON has all
#: Family of effects → what they state about a joint whose friction falls with speed, or does not.
CURVES = {
    "friction over speed": (
        "Friction on {joints} falls with speed",
        "Friction on {joints} is not a straight line over speed",
    )
}
MOST_LISTED = 3  # values in a list; of more the range is stated


def grouped(steps: Sequence[DiagnosisStep], mode: str) -> list[list[DiagnosisStep]]:
    """Return the steps by finding, those that explain the largest part of a torque first.

    Steps with the same effect on several joints are one finding if the sign of their first
    coefficients is the same and, as missing effects, they have the same rivals; a change on
    several joints has one cause, and its rivals are those of all joints. So are steps on one
    joint whose effects are of one family: together they stand for one curve.

    Parameters
    ----------
    steps : sequence of DiagnosisStep
    mode : str
        ``missing`` or ``changed``.
    """
    groups: dict[tuple[object, ...], list[DiagnosisStep]] = {}
    for step in steps:
        single = len(step.joints) == 1
        rivals = tuple(sorted({c.name for c, _ in step.indistinguishable}))
        if mode == "changed":
            rivals = ()
        key: tuple[object, ...] = (step.label.partition(":")[0], _is_positive(step), rivals)
        if not single:
            key = (step.label,)
        elif _curve_of(step, steps):
            key = (_family(step.effect), step.joints)
        groups.setdefault(key, []).append(step)
    found = [sorted(group, key=lambda s: (s.joints, s.effect)) for group in groups.values()]
    return sorted(found, key=lambda group: -max(step.share for step in group))


def _curve_of(step: DiagnosisStep, steps: Sequence[DiagnosisStep]) -> bool:
    """Whether a step has another effect of its family beside it on its joint."""
    family = _family(step.effect)
    return bool(family) and any(
        other.effect != step.effect
        and other.joints == step.joints
        and _family(other.effect) == family
        for other in steps
    )


def findings(d: Diagnosis) -> list[str]:
    """Return one sentence for each finding."""
    return [_finding(group, d) for group in grouped(d.steps, d.mode)]


def _finding(steps: Sequence[DiagnosisStep], d: Diagnosis) -> str:
    """Return effect, joints, size, part of the error, and rivals."""
    first = steps[0]
    error = "held-out error" if d.mode == "missing" else "error"
    falls = [
        100 * (1.0 - step.evidence.held_out_after / step.evidence.held_out_before) for step in steps
    ]
    part = f"{_listed([f'{fall:.0f} %' for fall in falls], falls)} of the {error}"
    if not first.joints:
        part += f" of joint {first.evidence.joint + 1}"
    if len({step.effect for step in steps}) > 1:
        sizes = "; ".join(f"{step.effect}: {'; '.join(_sizes([step]))}" for step in steps)
        return (
            f"{_curve(steps, d)} ({sizes}; in addition to each other {part}): neither form is "
            "sufficient alone, and the form of the curve is not identified."
        )
    statement = _curve(steps, d) if _rivals_in_form(first) else _statement(first, steps, d.mode)
    sizes = "; ".join(_sizes(steps))
    name = first.label.partition(":")[0]
    return f"{statement} ({name}: {sizes}; {part}){_rivals(steps)}{_repeated(steps)}."


def _curve(steps: Sequence[DiagnosisStep], d: Diagnosis) -> str:
    """Return what effects of one family state together: the curve, not its form."""
    texts = CURVES[_family(steps[0].effect)]
    joints = sorted({step.joints[0] for step in steps})
    falls = all(d.mode == "missing" and _falls_with_speed(joint, d) for joint in joints)
    numbers = join_words([str(joint + 1) for joint in joints])
    return texts[0 if falls else 1].format(joints=f"joint{'s' * (len(joints) > 1)} {numbers}")


def _falls_with_speed(joint: int, d: Diagnosis) -> bool:
    """Whether the fitted friction on a joint (from 0) falls with speed from standstill."""
    table = d.fit.parameter_table()
    values = {row["name"]: float(row["value"]) for row in table if row["joint"] == joint + 1}
    return values.get("viscous.f_v", 0.0) < 0.0 or values.get("stribeck.f_s-f_c", 0.0) > 0.0


def _rivals_in_form(step: DiagnosisStep) -> bool:
    """Whether all rivals of a step describe the same curve in another form."""
    family, rivals = _family(step.effect), step.indistinguishable
    return bool(family and rivals) and all(
        c.effect.family == family and c.joints == step.joints for c, _ in rivals
    )


def _repeated(steps: Sequence[DiagnosisStep]) -> str:
    """Return how often a finding, and it or one of its rivals, was selected, if it was seldom.

    Of several joints it is that with the fewest selections.
    """
    step = min(steps, key=lambda s: s.selected)
    if not step.selected < LEAST_SELECTED:
        return ""
    where = f" on {location(step.joints)}" if len(steps) > 1 else ""
    text = (
        f"; on resampled data it was selected{where} in {100 * step.selected:.0f} % of the "
        "repetitions"
    )
    together, rivals = step.evidence.selected_with_rivals, step.indistinguishable
    if not rivals or not together > step.selected:
        return text
    name = rival_text(rivals[0][0].name, rivals[0][0].joints, step)
    rival = name if len(rivals) == 1 else "one of its rivals"
    return f"{text}, it or {rival} in {100 * together:.0f} %"


def _statement(first: DiagnosisStep, steps: Sequence[DiagnosisStep], mode: str) -> str:
    effect = _effect(first.effect)
    texts = () if effect is None else effect.finding if mode == "missing" else effect.change
    if not texts:
        subject = "The model lacks" if mode == "missing" else "Changed:"
        return f"{subject} {first.effect} on {_joints(steps)}"
    text = texts[0] if _is_positive(first) else texts[-1]
    source = first.joints[1] + 1 if len(first.joints) == 2 else ""
    return text.format(joints=_joints(steps), source=source)


def _joints(steps: Sequence[DiagnosisStep]) -> str:
    """Return ``joint 3`` or ``joints 2 and 3``; ``all joints`` for effects on none."""
    numbers = [str(step.joints[0] + 1) for step in steps if step.joints]
    if not numbers:
        return "all joints"
    return f"joint{'s' if len(numbers) > 1 else ''} {join_words(numbers)}"


def _sizes(steps: Sequence[DiagnosisStep]) -> list[str]:
    """Return the parameters with units; of a single one without its name."""
    first = steps[0]
    effect = _effect(first.effect)
    text = "" if effect is None or len(steps) > 1 else effect.size_text(first.parameters)
    if text:
        return [text]
    size_unit = "" if effect is None else effect.size_unit
    texts = []
    for name, own_unit in first.units.items():
        unit = size_unit if own_unit == "1" else own_unit
        factor = 100.0 if unit == "%" else 1.0
        values = [factor * step.parameters[name] for step in steps]
        value = f"{_listed([_number(v) for v in values], values)} {unit}".rstrip()
        texts.append(value if len(first.units) == 1 else f"{name} = {value}")
    return texts


def _listed(texts: Sequence[str], values: Sequence[float]) -> str:
    """Return texts of values as a list; of many values the smallest and the largest.

    Texts that are all equal are one.
    """
    if len(set(texts)) == 1:
        return texts[0]
    if len(texts) <= MOST_LISTED:
        return join_words(texts)
    order = sorted(range(len(texts)), key=lambda k: values[k])
    return f"{texts[order[0]]} to {texts[order[-1]]}"


def _number(value: float) -> str:
    """Return a number with three digits, without exponent between 10⁻⁴ and 10⁵."""
    text = f"{value:.3g}"
    return (f"{value:.0f}" if "e+0" in text else text).replace("-", "−")


def _rivals(steps: Sequence[DiagnosisStep]) -> str:
    """Return the rivals that all steps of a finding have, as the end of its sentence."""
    step = steps[0]
    shared = set.intersection(*({c.name for c, _ in s.indistinguishable} for s in steps))
    rivals = [c for c, _ in step.indistinguishable if c.name in shared]
    labels = [rival_text(c.name, c.joints, step) for c in rivals]
    labels += [" with ".join(c.placement.label for c in pair) for pair in step.rival_pairs]
    if not labels:
        return ""
    shown = labels[:MOST_RIVALS]
    further = len(labels) - len(shown)
    more = f" or {further} other{'s' * (further > 1)}" if further else ""
    fit = "fits" if len(labels) == 1 else "fit"
    if _rivals_in_form(step):
        return f", or {' or '.join(shown)}{more}: the form of the curve is not identified"
    return f", or {' or '.join(shown)}{more}, which {fit} as well"


def rival_text(name: str, joints: tuple[int, ...], step: DiagnosisStep) -> str:
    """Return the name of a rival, with its joints where they are not those of the step.

    Parameters
    ----------
    name : str
    joints : tuple of int
        Of the rival, from 0.
    step : DiagnosisStep
    """
    return name if joints == step.joints else f"{name} on {location(joints)}"


def location(joints: tuple[int, ...]) -> str:
    """Return ``joint 3``, ``joint 5 from joint 6`` or ``the whole arm`` (joints from 0)."""
    if not joints:
        return "the whole arm"
    if len(joints) == 2:
        return f"joint {joints[0] + 1} from joint {joints[1] + 1}"
    return f"joint {joints[0] + 1}"


def _is_positive(step: DiagnosisStep) -> bool:
    return next(iter(step.parameters.values()), 0.0) >= 0.0


def _family(name: str) -> str:
    effect = _effect(name)
    return "" if effect is None else effect.family


def _effect(name: str) -> Effect | None:
    """Return the registered effect with a name; None where a user's effect is not registered."""
    return make(name) if name in REGISTER else None
