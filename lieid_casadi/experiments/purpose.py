"""What a diagnosis leaves open, and what the next motion is for."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

from lieid_casadi.diagnosis import Diagnosis
from lieid_casadi.diagnosis.candidates import follows_temperature
from lieid_casadi.diagnosis.findings import difference_sentence
from lieid_casadi.diagnosis.options import DiagnosisOptions
from lieid_casadi.diagnosis.step import Step
from lieid_casadi.effects.registry import Library, make

Group = tuple[str, ...]
Kind = Literal["excitation", "temperature", "rivals", "range", "evidence"]

#: motions for one open question at most
TRIES = {"temperature": 2, "rivals": 2, "range": 1, "evidence": 1}
COLD_AND_WARM = (
    "No motion sets a temperature: record one motion with the arm cold and again after an hour of "
    "work, and start from these recordings."
)
MOST_RIVALS = 4  # of one effect that a motion separates from it, nearest first


@dataclass(frozen=True)
class Purpose:
    """What a motion is for.

    The kind is ``excitation`` (all parameters), ``temperature`` (as long an excitation as possible,
    the same each time: joints warm up while they move), ``rivals`` (to separate the effects of each
    group), ``range`` (of ``signals``, where no effect describes the error) or ``evidence`` (for
    effects that parts of the data do not show, or whose gain on held-out parts is not certain).
    """

    kind: Kind
    #: labels such as ``stribeck:2``, the effect in the model first; with ``range``: ``joint 2``
    groups: tuple[Group, ...] = ()
    signals: tuple[str, ...] = ()  # with ``range``: such as ``dq2``
    why: str = ""  # one sentence
    #: with ``evidence``, by group: what a motion should show of it, relative to the recordings
    growth: tuple[float, ...] = ()


def purposes(
    diagnosis: Diagnosis | None,
    asked: Sequence[Purpose],
    *,
    recorded: float = 0.0,
    left: float = 0.0,
) -> list[Purpose]:
    """Return what the next motion could be for, the most important first.

    A question is dropped after as many motions as `TRIES` states; ``asked`` are those so far.
    ``recorded`` is the time of the recordings that were diagnosed, ``left`` that which can still be
    recorded, s.
    """
    if diagnosis is None:
        return [Purpose("excitation", why="There is no recording yet.")]
    found = []
    tried = Counter((p.kind, frozenset(group)) for p in asked for group in p.groups)

    def new(kind: Kind, groups: Sequence[Group]) -> tuple[Group, ...]:
        return tuple(g for g in groups if tried[kind, frozenset(g)] < TRIES[kind])

    if not any(purpose.kind == "excitation" for purpose in asked):
        why = "The recordings show less than an excitation of the same length would."
        found.append(Purpose("excitation", why=why))
    if groups := new("temperature", [(label,) for label in warming(diagnosis)]):
        text = ", ".join(label for (label,) in groups)
        why = f"Perhaps due to temperature: {text}. Joints warm up along one long motion."
        found.append(Purpose("temperature", groups, why=why))
    if groups := new("rivals", separable_groups(diagnosis)):
        text = "; ".join(" or ".join(group) for group in groups)
        found.append(Purpose("rivals", groups, why=f"The recordings do not separate {text}."))
    signals_of = undescribed(diagnosis)
    if groups := new("range", [(joint,) for joint in signals_of]):
        signals = tuple(dict.fromkeys(x for (joint,) in groups for x in signals_of[joint]))
        text = ", ".join(joint for (joint,) in groups)
        why = f"No effect of the library describes the error of {text} over {', '.join(signals)}."
        found.append(Purpose("range", groups, signals, why))
    options = DiagnosisOptions()
    doubtful = {in_question(s): s.evidence.certainty for s in diagnosis.steps if _may_be_decided(s)}
    doubtful |= {
        label: deviations
        for label, deviations in diagnosis.undecided
        if recorded * growth(options.gain_deviations, deviations) <= left
    }
    if groups := new("evidence", [(label,) for label in doubtful]):
        text = ", ".join(label for (label,) in groups)
        why = f"The recordings do not suffice to be certain of {text}."
        wanted = tuple(growth(options.name_deviations, doubtful[label]) for (label,) in groups)
        found.append(Purpose("evidence", groups, why=why, growth=wanted))
    return found


def growth(wanted: float, deviations: float) -> float:
    """Return how much more data, relative to the present ones, a gain needs for a name.

    ``wanted`` and ``deviations`` are in standard errors, which fall with the root of the time.
    """
    return max((wanted / deviations) ** 2 - 1.0, 0.0)


def _may_be_decided(step: Step) -> bool:
    """Whether further data of any motion may decide on an effect.

    The motion that separates rivals has precedence: there may be none within the limits and the
    time that is left, for the worse of both ways round.
    """
    if step.status == "one_of":
        alone = not step.rivals and step.doubt != "lead"  # which no motion takes away
        return alone or any(rival.kind == "data" for rival in step.rivals)
    return step.status == "shape" and not _is_established(step)


def in_question(step: Step) -> str:
    """Return the effect that further data decide on: of a function, that of the library in it."""
    library = [r.label for r in step.rivals if step.status == "shape" and r.effect != step.effect]
    return library[0] if library else step.label


def _is_established(step: Step) -> bool:
    """Whether a function is found whatever part of the data is left out, or another function."""
    alone = in_question(step) != step.label
    return (step.evidence.selected if alone else step.evidence.selected_with_rivals) == 1.0


def open_groups(diagnosis: Diagnosis) -> list[Group]:
    """Return the effects of every step that is not named, with those that would do as well."""
    return [
        (step.label, *(rival.label for rival in step.rivals))
        for step in diagnosis.steps
        if step.status != "named"
    ]


def separable_groups(diagnosis: Diagnosis) -> list[Group]:
    """Return the groups of effects that other data could separate."""
    groups = [
        (step.label, *[r.label for r in step.rivals if r.kind == "data"][:MOST_RIVALS])
        for step in diagnosis.steps
        if step.status == "one_of"
    ]
    return [group for group in groups if len(group) > 1]


def undescribed(diagnosis: Diagnosis) -> dict[str, Group]:
    """Return the joints with an error that no effect describes: on which signals it depends."""
    shapes = [s for s in diagnosis.steps if s.status == "shape" and _is_established(s)]
    found = {f"joint {s.joint + 1}": s.depends_on for s in shapes}
    for part in diagnosis.unexplained:
        found.setdefault(f"joint {part.joint + 1}", part.depends_on or (f"dq{part.joint + 1}",))
    return found


def warming(diagnosis: Diagnosis) -> list[str]:
    """Return open effects of temperature, and joints whose error follows it or the time."""
    steps = [s.label for s in diagnosis.steps if s.status != "named"]
    steps += [label for label, _ in diagnosis.undecided]
    library = diagnosis.fit.model.library
    return [label for label in steps if _is_thermal(label, library)] + [
        f"joint {part.joint + 1}"
        for part in diagnosis.unexplained
        if {"t", f"temp{part.joint + 1}"} & set(part.depends_on)
        or any(_is_thermal(label, library) for label, _ in part.candidates)
    ]


def _is_thermal(label: str, library: Library) -> bool:
    """Whether an effect acts by a temperature, or stands for one that is not measured."""
    name = label.partition(":")[0]
    return follows_temperature(library[name]() if name in library else make(name))


def remaining(diagnosis: Diagnosis) -> list[str]:
    """Return a sentence for everything that is not named, explained or the same at all times."""
    parts = []
    for step in diagnosis.steps:
        group = [step.label, *(rival.label for rival in step.rivals)]
        if step.status == "shape":
            parts.append(f"{step.label}: no effect of the library describes it.")
        elif step.status == "one_of" and not step.rivals:
            parts.append(f"{step.label}: its name is not certain.")
        elif step.status == "one_of" and all(rival.kind == "exact" for rival in step.rivals):
            parts.append(f"No data can separate {' from '.join(group)}.")
        elif step.status == "one_of":
            parts.append(f"{' or '.join(group)}: not separated.")
    parts += [difference_sentence(each) for each in diagnosis.differing]
    if warming(diagnosis):
        parts.append(COLD_AND_WARM)
    return parts + [f"Joint {part.joint + 1}: {part.relation}." for part in diagnosis.unexplained]
