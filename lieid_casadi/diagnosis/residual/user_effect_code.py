"""Python code that registers unexplained parts as user-defined effects."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

from lieid_casadi.diagnosis.residual.function_dictionary import Term
from lieid_casadi.diagnosis.residual.shapes import SmoothShape
from lieid_casadi.diagnosis.residual.signal_names import SIGNAL_KEYS, split_name
from lieid_casadi.diagnosis.residual.smooth_function_code import smooth_lists
from lieid_casadi.diagnosis.screening.smooth_functions import has_memory, measured_signal
from lieid_casadi.effects.registry import REGISTER

if TYPE_CHECKING:
    from lieid_casadi.diagnosis.residual.unexplained import Unexplained

LETTERS = "abc"


@dataclass(frozen=True)
class OwnEffects:
    """User-defined effects with which to repeat a diagnosis.

    Attributes
    ----------
    code : str
        Python code that registers them, for ``--effects-file``; empty if there are none.
    labels : tuple of str
        For ``--effects``: ``own_2:2``, or ``own_2_1:2<1`` where joint 1 acts on joint 2.
    """

    code: str
    labels: tuple[str, ...]


def own_effects(parts: Sequence[Unexplained]) -> OwnEffects:
    """Return unexplained parts as user-defined effects with free coefficients.

    A formula gives one effect for each joint whose signals it depends on; without a formula the
    first smooth function is used. Parts that would not hold for another recording, and parts that
    an effect of the library contains, are left out. Products of signals of two other joints
    cannot be written as an effect on one joint, and functions of a signal's past not as a function;
    a comment in the code lists them.
    """
    blocks: list[str] = []
    notes: list[str] = []
    labels: list[str] = []
    for part in parts:
        if part.contained_in or not part.carries_over:
            continue
        by_source, beyond = _by_source(part)
        notes += [
            f"# joint {part.joint + 1}, {text}, "
            f"which needs a subclass of lieid_casadi.effects.{kind}"
            for text, kind in beyond
        ]
        for source, terms in by_source.items():
            name = _free_name(part.joint, source)
            acting = "" if source is None else f"<{source + 1}"
            labels.append(f"{name}:{part.joint + 1}{acting}")
            if part.formula is None:
                blocks.append(_smooth(name, part.shapes[0], source))
            else:
                unit = dict(zip(part.formula.terms, part.formula.units, strict=True))
                blocks.append(_of_terms(name, part.joint, source, terms, unit))
    if not blocks:
        return OwnEffects("".join(note + "\n" for note in notes), ())
    head = ["import casadi as ca", "", "import lieid_casadi as lieid", *notes]
    code = "\n".join([*head, "", "", "\n\n\n".join(blocks), ""])
    return OwnEffects(code, tuple(labels))


def _by_source(part: Unexplained) -> tuple[dict[int | None, list[Term]], list[tuple[str, str]]]:
    """Return the terms by the other joint that acts, and those that need a class of their own.

    The key is None for terms of the part's own joint. Without a formula the terms are empty. Of
    terms that are no function of one joint's signals, what they are and the base class are stated.
    """
    if part.formula is None:
        if not part.terms:
            return {}, []
        names = part.terms[0]
        if has_memory(names):
            return {}, [(f"hysteresis over {measured_signal(names[0])}", "Effect with states")]
        others = sorted({split_name(name)[1] for name in names if name != "t"} - {part.joint})
        if len(others) > 1:
            return {}, [(_of_two_other_joints(" and ".join(names)), "ArmEffect")]
        return {others[0] if others else None: []}, []
    found: dict[int | None, list[Term]] = {}
    beyond = []
    for term in part.formula.terms:
        others = sorted(term.joints - {part.joint})
        if len(others) > 1:
            beyond.append(term)
        else:
            found.setdefault(others[0] if others else None, []).append(term)
    sources = [source for source in found if source is not None]
    if None in found and len(sources) == 1:  # an effect of two joints has the signals of both
        found = {sources[0]: [term for term in part.formula.terms if term not in beyond]}
    return found, [(_of_two_other_joints(term.text), "ArmEffect") for term in beyond]


def _of_two_other_joints(text: str) -> str:
    return f"{text}: depends on two other joints"


def _free_name(joint: int, source: int | None) -> str:
    """Return a name that is not registered; effects of an earlier run may still be loaded."""
    name = f"own_{joint + 1}" if source is None else f"own_{joint + 1}_{source + 1}"
    endings = ["", *"bcdefghijklmnopqrstuvwxyz"]
    return next((name + end for end in endings if name + end not in REGISTER), name)


def _smooth(name: str, shape: SmoothShape, source: int | None) -> str:
    """Return the code of an effect that is a smooth function."""
    members = {column: _member(column, shape.joint) for column in shape.signals}
    lists = smooth_lists(shape, members)
    count = math.prod(size for _, size in lists)
    body = [f"    return {lists[0][0]}"]
    if len(lists) == 2:
        body = [
            f"    first = {lists[0][0]}",
            f"    second = {lists[1][0]}",
            "    return [a * b for a in first for b in second]",
        ]
    signals = dict.fromkeys(SIGNAL_KEYS[split_name(column)[0]] for column in shape.signals)
    signals |= {"sign": None} if "dq" in signals else {}
    coefficients = f'{{f"c{{k}}": "N·m" for k in range(1, {count + 1})}}'
    formula = f"a smooth function of {', '.join(shape.signals)}"
    return _decorated(name, formula, coefficients, signals, source, body)


def _of_terms(
    name: str, joint: int, source: int | None, terms: Sequence[Term], unit: Mapping[Term, str]
) -> str:
    """Return the code of an effect that is a sum of terms of a formula."""
    letters = LETTERS[: len(terms)]
    formula = " + ".join(f"{a}·{t.text}" for a, t in zip(letters, terms, strict=True))
    each = ", ".join(f'"{a}": "{unit[t]}"' for a, t in zip(letters, terms, strict=True))
    body = [f"    return [{', '.join(_code(term, joint) for term in terms)}]"]
    return _decorated(name, formula, f"{{{each}}}", _signals(terms), source, body)


def _decorated(
    name: str,
    formula: str,
    coefficients: str,
    signals: Iterable[str],
    source: int | None,
    body: Sequence[str],
) -> str:
    """Return the code of a decorated function with the given lines as its body."""
    lines = [
        "@lieid.effect(",
        f'    "{name}",',
        f'    formula="{formula}",',
        f"    coefficients={coefficients},",
        "    signals=[" + ", ".join(f'"{s}"' for s in signals) + "],",
        *(["    couples=True,"] if source is not None else []),
        ")",
        f"def {name}(s, shape):",
        *body,
    ]
    return "\n".join(lines)


def _signals(terms: Sequence[Term]) -> list[str]:
    """Return the names of the signals that terms depend on, without repetition."""
    used: dict[str, None] = {}
    for term in terms:
        for name, function in term.factors:
            member = "sign" if function.code == "{s}.sign" else SIGNAL_KEYS[split_name(name)[0]]
            used[member] = None
    return list(used)


def _code(term: Term, joint: int) -> str:
    factors = []
    for name, function in term.factors:
        member = _member(name, joint)
        factors.append(function.code.format(x=member, s=member.rpartition(".")[0]))
    return " * ".join(factors)


def _member(name: str, joint: int) -> str:
    """Return the expression of a signal in an effect on a joint: ``s.q``, ``s.other.dq``."""
    kind, source = split_name(name)
    return f"{'s' if source == joint or kind == 't' else 's.other'}.{SIGNAL_KEYS[kind]}"
