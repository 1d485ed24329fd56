"""Descriptions of the effects that a report names."""

from __future__ import annotations

from collections.abc import Iterable

from lieid_casadi.effects import make
from lieid_casadi.effects.description import describe
from lieid_casadi.effects.registry import REGISTER
from lieid_casadi.report.section import Section


def anchors(labels: Iterable[str]) -> dict[str, str]:
    """Return effect → anchor of its description in the page."""
    return {label: f"effect-{label.replace('/', '-')}" for label in labels if label in REGISTER}


def descriptions_section(labels: Iterable[str]) -> Section:
    """Return the descriptions of effects: formula, coefficients, rivals, and what reveals them.

    Parameters
    ----------
    labels : iterable of str
        Names, with options; those that are not registered are left out.
    """
    effects = [
        {"label": label, "anchor": anchor, "facts": describe(make(label))}
        for label, anchor in anchors(dict.fromkeys(labels)).items()
    ]
    return Section("Effects in this report", "effects.html", {"effects": effects}, folded=True)
