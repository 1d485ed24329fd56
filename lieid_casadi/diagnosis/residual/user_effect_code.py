"""What stays unexplained as an effect of the user's own: lines of Python to keep in a file."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

from lieid_casadi.diagnosis.residual.function_dictionary import Term
from lieid_casadi.diagnosis.residual.shapes import SmoothShape, split_column
from lieid_casadi.diagnosis.residual.smooth_effect import smooth_lists
from lieid_casadi.diagnosis.residual.unexplained import Unexplained
from lieid_casadi.effects.effect import REGISTER

LETTERS = "abc"
MEMBERS = {"q": "q", "dq": "dq", "ddq": "ddq", "load": "load", "temp": "temperature", "t": "time"}


@dataclass(frozen=True)
class OwnEffects:
    """Effects to run a diagnosis again with.

    Attributes
    ----------
    code : str
        Python that registers them; a file for ``--effects-file``. Empty if there are none.
    labels : tuple of str
        How they are placed: ``own_2:2``, or ``own_2_1:2<1`` where joint 1 acts on joint 2.
    """

    code: str
    labels: tuple[str, ...]


def own_effects(parts: Sequence[Unexplained]) -> OwnEffects:
    """Return unexplained parts as effects, their coefficients free.

    Of a formula one effect for each joint that acts on the part's own; without a formula, the
    strongest smooth function. Products of two other joints' signals have no place in an effect on
    one joint: a comment tells them.
    """
    blocks: list[str] = []
    notes: list[str] = []
    labels: list[str] = []
    for part in parts:
        by_source, beyond = _by_source(part)
        notes += [
            f"# joint {part.joint + 1}, {text}: two other joints act together, "
            "which needs a class of your own"
            for text in beyond
        ]
        for source, terms in by_source.items():
            name = _free_name(part.joint, source)
            acting = "" if source is None else f"<{source + 1}"
            labels.append(f"{name}:{part.joint + 1}{acting}")
            if part.form is None:
                blocks.append(_smooth(name, part.shapes[0], source))
            else:
                unit = dict(zip(part.form.terms, part.form.units, strict=True))
                blocks.append(_of_terms(name, part.joint, source, terms, unit))
    if not blocks:
        return OwnEffects("".join(note + "\n" for note in notes), ())
    head = ["import casadi as ca", "", "import lieid_casadi as lieid", *notes]
    code = "\n".join([*head, "", "", "\n\n\n".join(blocks), ""])
    return OwnEffects(code, tuple(labels))


def _by_source(part: Unexplained) -> tuple[dict[int | None, list[Term]], list[str]]:
    """Return the terms by the other joint that acts, and what two others act on together.

    Without a formula the terms are empty.
    """
    if part.form is None:
        if not part.shapes:
            return {}, []
        names = part.shapes[0].signals
        others = sorted({split_column(name)[1] for name in names if name != "t"} - {part.joint})
        if len(others) > 1:
            return {}, [" and ".join(names)]
        return {others[0] if others else None: []}, []
    found: dict[int | None, list[Term]] = {}
    beyond = []
    for term in part.form.terms:
        others = sorted(term.joints - {part.joint})
        if len(others) > 1:
            beyond.append(term)
        else:
            found.setdefault(others[0] if others else None, []).append(term)
    sources = [source for source in found if source is not None]
    if None in found and len(sources) == 1:  # an effect of two joints has the signals of both
        found = {sources[0]: [term for term in part.form.terms if term not in beyond]}
    return found, [term.text for term in beyond]


def _free_name(joint: int, source: int | None) -> str:
    """Return a name that no effect has: those of an earlier round may still be loaded."""
    name = f"own_{joint + 1}" if source is None else f"own_{joint + 1}_{source + 1}"
    endings = ["", *"bcdefghijklmnopqrstuvwxyz"]
    return next((name + end for end in endings if name + end not in REGISTER), name)


def _smooth(name: str, shape: SmoothShape, source: int | None) -> str:
    """Return a smooth function as a decorated function."""
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
    signals = dict.fromkeys(MEMBERS[split_column(column)[0]] for column in shape.signals)
    signals |= {"sign": None} if "dq" in signals else {}
    coefficients = f'{{f"c{{k}}": "N·m" for k in range(1, {count + 1})}}'
    formula = f"a smooth function of {', '.join(shape.signals)}"
    return _decorated(name, formula, coefficients, signals, source, body)


def _of_terms(
    name: str, joint: int, source: int | None, terms: Sequence[Term], unit: Mapping[Term, str]
) -> str:
    """Return terms of a formula as a decorated function."""
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
    """Return a decorated function."""
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
    """Return the names of the signals that terms use, each once."""
    used: dict[str, None] = {}
    for term in terms:
        for name, function in term.factors:
            member = "sign" if function.code == "{s}.sign" else MEMBERS[split_column(name)[0]]
            used[member] = None
    return list(used)


def _code(term: Term, joint: int) -> str:
    factors = []
    for name, function in term.factors:
        member = _member(name, joint)
        factors.append(function.code.format(x=member, s=member.rpartition(".")[0]))
    return " * ".join(factors)


def _member(name: str, joint: int) -> str:
    """Return what stands for a column in an effect on a joint: ``s.q``, ``s.other.dq``."""
    kind, source = split_column(name)
    return f"{'s' if source == joint or kind == 't' else 's.other'}.{MEMBERS[kind]}"
