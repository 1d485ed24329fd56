"""Review of the accepted effects in the final model: what each one adds to all the others."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from lieid_casadi.diagnosis.residual.unexplained import Unexplained
from lieid_casadi.diagnosis.review.final_rivals import with_final_rivals
from lieid_casadi.diagnosis.review.stability import with_stability
from lieid_casadi.diagnosis.screening.evidence import HypothesisFamily
from lieid_casadi.diagnosis.screening.late_friction import p_beside_late_friction
from lieid_casadi.diagnosis.screening.screen import screen
from lieid_casadi.diagnosis.search.alternatives import alternatives
from lieid_casadi.diagnosis.search.pruning import without_partial_effects
from lieid_casadi.diagnosis.search.search_problem import SearchProblem
from lieid_casadi.diagnosis.search.search_results import AcceptedEffect, Significance
from lieid_casadi.effects import Placement
from lieid_casadi.identification.uncertainty.noise_model import Noise

Array = NDArray[np.float64]


def reviewed_parts(problem: SearchProblem) -> tuple[Unexplained, ...]:
    """Review the accepted effects, remove those that only partly explain the residual.

    Returns
    -------
    tuple of Unexplained
        The unexplained parts of the residual of the effects that are kept.
    """
    while True:
        review(problem)
        count, parts = len(problem.accepted), without_partial_effects(problem)
        if len(problem.accepted) == count:
            return parts


def exchange_rivals(problem: SearchProblem) -> None:
    """Exchange accepted effects for better rivals."""
    problem.accepted = [_with_alternatives(effect, problem) for effect in problem.accepted]
    while problem.exchange_rival():
        pass


def review(problem: SearchProblem) -> None:
    """Keep the accepted effects that pass all tests in the last model, with their evidence there.

    An effect that fails because of effects added after it, or because the noise of the last model
    explains it, is removed, the one that explains least first, and the others are examined again.
    So are all if one is exchanged for a better rival.
    """
    while problem.accepted:
        examined = [problem.in_last_model(effect) for effect in problem.accepted]
        failed = [(effect, reason) for effect, reason in examined if reason]
        if not failed:
            effects = _with_significance(problem, [effect for effect, _ in examined])
            reasons = [_insignificant(problem, effect) for effect in effects]
            failed = [(e, reason) for e, reason in zip(effects, reasons, strict=True) if reason]
        if not failed:
            problem.accepted = [_with_alternatives(effect, problem) for effect in effects]
            if not problem.exchange_rival():
                return
            problem.fit_shapes()
            continue
        effect, reason = min(failed, key=lambda pair: _explained(pair[0]))
        problem.remove([effect.candidate.placement], f"in the final model {reason}")


def _with_alternatives(effect: AcceptedEffect, problem: SearchProblem) -> AcceptedEffect:
    """Return an accepted effect with its rivals, and how often it is selected again."""
    found = alternatives(effect, problem)
    return with_stability(with_final_rivals(found, problem), found, problem)


def _explained(effect: AcceptedEffect) -> float:
    """Return the relative fall of the mean square error on the joint where it falls most."""
    before, after = effect.errors[:, effect.joint]
    return float(1.0 - (after / before) ** 2)


def _with_significance(
    problem: SearchProblem, effects: Sequence[AcceptedEffect]
) -> list[AcceptedEffect]:
    context, options = problem.context, problem.options
    coloured = problem.last_noise()
    candidates = problem.candidates(coloured)
    family = HypothesisFamily.of(
        screen(candidates, problem.baseline(coloured, candidates), None),
        seed=problem.seed,
        draws=options.bootstrap_draws,
        further=context.scanned,
    )
    return [
        replace(
            effect,
            significance=_significance(problem, coloured, family, effect.candidate.placement),
        )
        for effect in effects
    ]


def _insignificant(problem: SearchProblem, effect: AcceptedEffect) -> str:
    """Return the reason for which an accepted effect counts as noise; empty if it does not.

    A delay of torque must explain more than dry friction that reverses late.
    """
    reason = problem.insignificant(effect.significance)
    placement = effect.candidate.placement
    if reason or not placement.effect.delays_torque:
        return reason
    noise, limit = problem.last_noise(), problem.options.significance
    without, own = problem.baseline_without(placement, noise), problem.columns_of(placement, noise)
    p = p_beside_late_friction(without, own, problem.context, noise, placement)
    if p <= limit:
        return ""
    return f"not significant beside dry friction that reverses late: p = {p:.2g} (limit {limit:g})"


def _significance(
    problem: SearchProblem,
    noise: Sequence[Noise],
    family: HypothesisFamily,
    placement: Placement,
) -> Significance:
    """Return the evidence for an accepted effect in addition to all the others."""
    without = problem.baseline_without(placement, noise)
    columns = problem.columns_of(placement, noise)
    n = len(problem.context.runs)
    statistic, degrees, dispersion = without.evidence(columns, n)
    log10_p, rows = family.log10_p(statistic, degrees), int(without.ends[n])
    return Significance(log10_p, statistic, degrees, rows, family.tests, dispersion)
