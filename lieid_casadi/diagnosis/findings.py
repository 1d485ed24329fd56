"""A diagnosis in sentences: one for each finding, with its numbers, status and rivals."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from lieid_casadi.diagnosis.step import Difference, Step, Unexplained
from lieid_casadi.effects.registry import REGISTER, make
from lieid_casadi.effects.smooth import Smooth
from lieid_casadi.messages import in_unit
from lieid_casadi.tables import with_std

MOST_RIVALS = 3  # named in a sentence; the JSON has all
MOST_LISTED = 3  # values in a list; of more the range is stated
#: Of an effect without rivals, by `Step.doubt`
DOUBTS = {
    "gain": "; its gain{where} is certain to only {gain:.1f} standard errors",
    "coefficients": "; it is only {coefficients:.1f} standard deviations from zero{where}",
    "instant": "; friction that changes at one instant may look the same",
    "late_friction": "; a joint that sticks for a moment at each reversal may look the same",
    "rest": "; more than it explains of the error is left unexplained",
    "lead": "; friction of another form at reversals may look the same",
}


def findings(steps: Sequence[Step], mode: str = "missing") -> list[list[Step]]:
    """Return the steps by finding, the largest share of a torque first.

    Steps with the same effect on several joints are one finding if their first coefficients have
    the same sign and, as missing effects, the same status and kinds of rivals; a change on several
    joints has one cause.
    """
    groups: dict[tuple[object, ...], list[Step]] = {}
    for step in steps:
        rivals = tuple(sorted({r.effect for r in step.rivals}))
        key: tuple[object, ...] = (step.group, _positive(step))
        if mode == "missing":
            key += (step.status, rivals)
        groups.setdefault(key, []).append(step)
    found = [sorted(group, key=lambda s: s.joints) for group in groups.values()]
    return sorted(found, key=lambda group: -max(step.share for step in group))


def finding(steps: Sequence[Step], mode: str) -> str:
    """Return one sentence: effect, joints, size, part of the error, status and rivals."""
    first = steps[0]
    error = "held-out error" if mode == "missing" else "error"
    falls = [100 * step.part for step in steps]
    part = f"{_listed([f'{fall:.0f} %' for fall in falls], falls)} of the {error}"
    if any(step.joint not in step.joints[:1] for step in steps):
        on = list(dict.fromkeys(str(step.joint + 1) for step in steps))
        part += f" of joint{'s' * (len(on) > 1)} {join_words(on)}"
    name = first.label.partition(":")[0]
    text = f"{_statement(steps, mode)} ({name}: {'; '.join(_sizes(steps))}; {part})"
    text += _rivals(steps) + _selected(steps) + _motion(steps)
    if first.formula:
        text += f"; it is close to {first.formula}"
    unconfirmed = [step for step in steps if step.confirmed is False]
    if unconfirmed:
        where = join_words([str(step.joint + 1) for step in unconfirmed])
        text += f"; the test does not confirm it on joint{'s' * (len(unconfirmed) > 1)} {where}"
    return text + "."


def _statement(steps: Sequence[Step], mode: str) -> str:
    first = steps[0]
    if first.status == "shape":
        signals = [_signal_text(name) for name in first.depends_on]
        verb = "depends" if mode == "missing" else "has changed and depends"
        return (
            f"An additional torque on {_joints(steps)} {verb} on {join_words(signals)}; no effect "
            "of the library describes it"
        )
    effect = make(first.effect) if first.effect in REGISTER else None
    texts = () if effect is None else (mode != "missing" and effect.change) or effect.finding
    if not texts:
        subject = "The model lacks" if mode == "missing" else "Changed:"
        return f"{subject} {first.effect} on {_joints(steps)}"
    text = texts[0] if _positive(first) else texts[-1]
    source = first.joints[1] + 1 if len(first.joints) == 2 else ""
    increased = "increased" if _positive(first) else "decreased"
    return text.format(joints=_joints(steps), source=source, increased=increased)


def _signal_text(name: str) -> str:
    """Return ``the velocity of joint 3`` for ``dq3``."""
    what = {
        "q": "angle", "dq": "velocity", "ddq": "acceleration", "load": "load",
        "temp": "temperature", "tau": "torque",
    }  # fmt: skip
    letters = name.rstrip("0123456789")
    return f"the {what[letters]} of joint {name[len(letters) :]}"


def _joints(steps: Sequence[Step]) -> str:
    numbers = [str(step.joints[0] + 1) for step in steps if step.joints]
    if not numbers:
        return "all joints"
    return f"joint{'s' if len(numbers) > 1 else ''} {join_words(numbers)}"


def _sizes(steps: Sequence[Step]) -> list[str]:
    """Return the parameters with standard deviations and units."""
    first = steps[0]
    effect = make(first.label.partition(":")[0]) if first.effect in REGISTER else None
    text = "" if effect is None or len(steps) > 1 else effect.size_text(first.parameters)
    if text:
        return [text]
    if first.status == "shape":
        return [f"{len(first.parameters)} coefficients"]
    size_unit = "" if effect is None else effect.size_unit
    texts = []
    for name, own_unit in first.units.items():
        unit = size_unit if own_unit == "1" else own_unit
        factor = 100.0 if unit == "%" else 1.0
        if not all(name in step.parameters for step in steps):
            continue
        values = [factor * step.parameters[name] for step in steps]
        deviations = [factor * step.std[name] for step in steps]
        shown = [_with_std(value, std) for value, std in zip(values, deviations, strict=True)]
        value = in_unit(_listed(shown, values), unit)
        texts.append(value if len(first.units) == 1 else f"{name} = {value}")
    return texts


def _with_std(value: float, std: float) -> str:
    return with_std(value, std).replace("-", "−")


def _rivals(steps: Sequence[Step]) -> str:
    """Return the rivals that all steps of a finding have, as the end of its sentence."""
    step = steps[0]
    shared = set.intersection(*({r.effect for r in s.rivals} for s in steps))
    if step.effect != Smooth.name and Smooth.name in shared:
        function = next(r.label for r in step.rivals if r.effect == Smooth.name).partition(":")[0]
        return f"; its form is not certain beside the function {function}"
    every = []
    for r in step.rivals:
        name = r.label.partition(":")[0] if r.effect == Smooth.name else r.effect
        if r.effect in shared:
            every.append(name if r.joints == step.joints else f"{name} on {location(r.joints)}")
    labels = list(dict.fromkeys(every))  # variants of one effect are named once
    if not labels:
        return ""
    shown = labels[:MOST_RIVALS]
    further = len(labels) - len(shown)
    more = f" or {further} other{'s' * (further > 1)}" if further else ""
    fit = "fits" if len(labels) == 1 else "fit"
    return f", or {' or '.join(shown)}{more}, which {fit} as well"


def _selected(steps: Sequence[Step]) -> str:
    step = min(steps, key=lambda s: (s.evidence.selected, s.evidence.certainty))
    where = f" on {location(step.joints)}" if len(steps) > 1 else ""
    selected, together = step.evidence.selected, step.evidence.selected_with_rivals
    if selected == 1.0:
        evidence = step.evidence
        text = "" if step.rivals or step.status != "one_of" else DOUBTS.get(step.doubt, "")
        return text.format(
            where=where, gain=evidence.gain_certainty, coefficients=evidence.coefficient_deviations
        )
    text = f"; without single parts of the data it was selected{where} in {100 * selected:.0f} %"
    return text + (f", it or a rival in {100 * together:.0f} %" if together > selected else "")


def _motion(steps: Sequence[Step]) -> str:
    """Return the errors of the simulated motion without and with a finding's effects."""
    errors = [
        [float(np.degrees(x[step.joint])) for x in (step.motion.before, step.motion.after)]
        for step in steps
        if step.motion is not None
    ]
    if not errors:
        return ""
    texts = [f"{number(after)}° in place of {number(before)}°" for before, after in errors]
    return f"; the simulated motion is {_listed(texts, [a for _, a in errors])} off"


def difference_sentence(each: Difference) -> str:
    """Return what is not the same in all training recordings, or in all of one."""
    values, differs = [], " =" if each.period is not None else " differs by"
    for name, value in each.parameters.items():
        size = in_unit(_with_std(value, each.std[name]), each.units.get(name, ""))
        values.append(f"{name}{differs} {size}")
    where, text = location(each.joints), join_words(values)
    if each.period is not None:
        return (
            f"The torque of {where} oscillates with time, whatever the motion: period "
            f"{number(each.period)} s, {text} ({each.recording}). No model of the arm has that."
        )
    if each.since is not None:
        return (
            f"Something changed during {each.recording}: from {number(each.since)} s on, "
            f"{each.effect} on {where} is not the same ({text}). No model of the arm has that."
        )
    what = "is not the same in all" if each.of_model else "is not found in all"
    return (
        f"The recordings differ from each other: in {each.recording}, {each.effect} "
        f"on {where} ({text}) {what}, so it is no effect of the arm."
    )


def unexplained_sentence(part: Unexplained) -> str:
    """Return the error of a joint that nothing lowers, with the nearest candidate."""
    text = f"On joint {part.joint + 1}, {part.relation}"
    if part.candidates:
        label, why = part.candidates[0]
        text += f"; nearest: {label} ({why})"
    return text + "."


def location(joints: tuple[int, ...]) -> str:
    """Return ``joint 3``, ``joint 5 from joint 6`` or ``the whole arm`` (joints from 0)."""
    if not joints:
        return "the whole arm"
    if len(joints) == 2:
        return f"joint {joints[0] + 1} from joint {joints[1] + 1}"
    return f"joint {joints[0] + 1}"


def number(value: float) -> str:
    """Return a number with three digits, without exponent between 10⁻⁴ and 10⁵."""
    text = f"{value:.3g}"
    return (f"{value:.0f}" if "e+0" in text else text).replace("-", "−")


def join_words(words: Sequence[str]) -> str:
    """Return ``a``, ``a and b`` or ``a, b and c``."""
    return " and ".join([*([", ".join(words[:-1])] if len(words) > 1 else []), words[-1]])


def _listed(texts: Sequence[str], values: Sequence[float]) -> str:
    """Return texts of values as a list; of many values the smallest and the largest."""
    if len(set(texts)) == 1:
        return texts[0]
    if len(texts) <= MOST_LISTED:
        return join_words(texts)
    order = sorted(range(len(texts)), key=lambda k: values[k])
    return f"{texts[order[0]]} to {texts[order[-1]]}"


def _positive(step: Step) -> bool:
    return next(iter(step.parameters.values()), 0.0) >= 0.0
