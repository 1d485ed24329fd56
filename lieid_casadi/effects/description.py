"""Descriptions of effects as text, from their definitions."""

from __future__ import annotations

import re
from html import escape

from lieid_casadi.effects.effect import Effect

#: A symbol of one letter with its accents; names of functions and subscripts stay upright.
_LETTER = re.compile("(?<![\\w&])([^\\W\\d_²³ᵀ][\u0300-\u036f]*)(?![\u0300-\u036f]|[^\\W_²³ᵀ])")


def describe(effect: Effect) -> list[tuple[str, str]]:
    """Return the facts about an effect: (name of the fact, text), in the order of reading."""
    facts = [("formula", effect.formula)]
    facts += [
        ("coefficient", _quantity(c.name, c.unit, c.meaning, c.lower, c.upper))
        for c in effect.coefficients
    ]
    facts += [
        ("shape parameter", _quantity(s.name, s.unit, s.meaning, s.lower, s.upper))
        for s in effect.shapes
    ]
    facts += [("state", f"{s.name} [{s.unit}], {s.initial:g} at the start") for s in effect.states]
    facts.append(("signals", ", ".join(effect.signals)))
    if effect.commanded:
        facts.append(("needs", "commanded positions and the drives' control law"))
    options = {} if effect.option else effect.options
    facts += [(f"option {effect.name}/{name}", text) for name, text in options.items()]
    facts.append(("revealed by", effect.revealed_by))
    facts += [(f"confused with {name}", text) for name, text in effect.confused_with.items()]
    facts.append(("typical size", effect.typical))
    facts += [("reference", text) for text in effect.references]
    return [(name, text) for name, text in facts if text]


def formula_html(formula: str) -> str:
    """Return a formula as HTML, with subscripts and exponents; all other text is escaped.

    Examples
    --------
    >>> formula_html("f_s·e^{−(q̇/v_s)²}")
    '<i>f</i><sub>s</sub>·<i>e</i><sup>−(<i>q̇</i>/<i>v</i><sub>s</sub>)²</sup>'
    """
    text = _LETTER.sub(r"<i>\1</i>", escape(formula))
    text = re.sub(r"_([^\W_²³]+)", r"<sub>\1</sub>", text)
    text = re.sub(r"\^(<i>[^<]*</i>(?:<sub>[^<]*</sub>)?)", r"<sup>\1</sup>", text)
    return re.sub(r"\^\{([^{}]*)\}", r"<sup>\1</sup>", text)


def _quantity(name: str, unit: str, meaning: str, lower: float, upper: float) -> str:
    text = f"{name} [{unit}]" + (f", {meaning}" if meaning else "")
    bounds = [f"at least {lower:g}"] if lower > -float("inf") else []
    bounds += [f"at most {upper:g}"] if upper < float("inf") else []
    return text + (f"; {', '.join(bounds)}" if bounds else "")
