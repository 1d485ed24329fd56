"""Stability of a selection: how often an effect, or one of its rivals, is selected again."""

from __future__ import annotations

from dataclasses import replace

from lieid_casadi.diagnosis.search.alternatives import Alternatives
from lieid_casadi.diagnosis.search.block_bootstrap import competition
from lieid_casadi.diagnosis.search.search_problem import SearchProblem
from lieid_casadi.diagnosis.search.search_results import AcceptedEffect


def with_stability(
    effect: AcceptedEffect, alternatives: Alternatives, problem: SearchProblem
) -> AcceptedEffect:
    """Return an accepted effect with the fraction of repetitions in which it is selected again.

    If these are too few, the candidates that are selected in its place are among its rivals.

    Parameters
    ----------
    effect : AcceptedEffect
    alternatives : Alternatives
        Of this effect.
    problem : SearchProblem
    """
    found, rivals = competition(alternatives, problem), effect.rivals
    labels = [other.candidate.placement.label for other in found.others]
    known = {c.placement.label for c, _ in rivals}
    if found.selected < problem.options.least_selected:
        rivals += tuple(
            (found.others[k].candidate, "data")
            for k in found.ranked
            if found.others_selected[k] > 0.0 and labels[k] not in known
        )
    known = {c.placement.label for c, _ in rivals}
    of_rivals = found.others_selected[[label in known for label in labels]]
    return replace(
        effect,
        selected=found.selected,
        selected_with_rivals=found.selected + float(of_rivals.sum()),
        rivals=rivals,
    )
