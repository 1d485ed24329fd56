"""What stays unexplained as an effect of the user's own: lines of Python to keep in a file."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence

from lieid_casadi.diagnosis.dictionary import Term
from lieid_casadi.diagnosis.shapes import split_column
from lieid_casadi.diagnosis.smooth_effect import smooth_lists
from lieid_casadi.diagnosis.unexplained import Unexplained

LETTERS = "abc"
MEMBERS = {"q": "q", "dq": "dq", "ddq": "ddq", "load": "load", "temp": "temperature", "t": "time"}


def effect_code(part: Unexplained) -> str:
    """Return Python that registers an unexplained part as an effect, its coefficients free.

    Of the formula one effect for each joint that acts on the part's own; without a formula, the
    strongest smooth function. Empty if that is a product of two other joints' signals.
    """
    if part.form is None:
        blocks, notes = _smooth(part), []
    else:
        by_source, beyond = _by_source(part.joint, part.form.terms)
        unit = dict(zip(part.form.terms, part.form.units, strict=True))
        blocks = [
            _decorated(_name(part.joint, source), part.joint, source, terms, unit)
            for source, terms in by_source.items()
        ]
        notes = [
            f"# {term.text}: two other joints act together, which needs a class of your own"
            for term in beyond
        ]
    if not blocks:
        return "\n".join([*notes, ""]) if notes else ""
    head = ["import casadi as ca", "", "import lieid_casadi as lieid", *notes]
    return "\n".join([*head, "", "", "\n\n\n".join(blocks), ""])


def effect_labels(part: Unexplained) -> tuple[str, ...]:
    """Return the effects of `effect_code` as they are placed: ``own_2:2``, ``own_2_1:2<1``."""
    if part.form is not None:
        sources = list(_by_source(part.joint, part.form.terms)[0])
    else:
        others = _others(part)
        sources = [*others, None][:1] if part.shapes and len(others) < 2 else []
    return tuple(
        f"{_name(part.joint, source)}:{part.joint + 1}"
        + ("" if source is None else f"<{source + 1}")
        for source in sources
    )


def _others(part: Unexplained) -> list[int]:
    """Return the other joints (from 0) whose signals the strongest smooth function has."""
    names = part.shapes[0].signals if part.shapes else ()
    return sorted({split_column(name)[1] for name in names if name != "t"} - {part.joint})


def _smooth(part: Unexplained) -> list[str]:
    """Return the strongest smooth function as a decorated function."""
    others = _others(part)
    if not part.shapes or len(others) > 1:
        return []
    shape, source = part.shapes[0], others[0] if others else None
    members = {name: _member(name, part.joint) for name in shape.signals}
    lists = smooth_lists(shape, members)
    count, (columns, _) = 1, lists[0]
    for _, size in lists:
        count *= size
    body = [f"    return {columns}"]
    if len(lists) == 2:
        body = [
            f"    first = {columns}",
            f"    second = {lists[1][0]}",
            "    return [a * b for a in first for b in second]",
        ]
    signals = dict.fromkeys(MEMBERS[split_column(name)[0]] for name in shape.signals)
    signals |= {"sign": None} if "dq" in signals else {}
    coefficients = f'{{f"c{{k}}": "N·m" for k in range(1, {count + 1})}}'
    formula = f"a smooth function of {', '.join(shape.signals)}"
    return [_written(_name(part.joint, source), formula, coefficients, signals, source, body)]


def _by_source(
    joint: int, terms: Sequence[Term]
) -> tuple[dict[int | None, list[Term]], list[Term]]:
    """Return the terms by the other joint that acts, and those that two others act on."""
    found: dict[int | None, list[Term]] = {}
    beyond = []
    for term in terms:
        others = sorted(term.joints - {joint})
        if len(others) > 1:
            beyond.append(term)
        else:
            found.setdefault(others[0] if others else None, []).append(term)
    own = found.get(None, [])
    sources = [source for source in found if source is not None]
    if own and len(sources) == 1:  # an effect of two joints has the signals of both
        found = {sources[0]: [term for term in terms if term not in beyond]}
    return found, beyond


def _name(joint: int, source: int | None) -> str:
    return f"own_{joint + 1}" if source is None else f"own_{joint + 1}_{source + 1}"


def _decorated(
    name: str, joint: int, source: int | None, terms: Sequence[Term], unit: Mapping[Term, str]
) -> str:
    letters = LETTERS[: len(terms)]
    formula = " + ".join(f"{a}·{t.text}" for a, t in zip(letters, terms, strict=True))
    each = ", ".join(f'"{a}": "{unit[t]}"' for a, t in zip(letters, terms, strict=True))
    body = [f"    return [{', '.join(_code(term, joint) for term in terms)}]"]
    return _written(name, formula, f"{{{each}}}", _signals(terms), source, body)


def _written(
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
        f"    signals=[{', '.join(repr(s) for s in signals)}],".replace("'", '"'),
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
