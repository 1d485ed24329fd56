"""The stepwise search for effects, for any problem that states baseline and acceptance."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from lieid_casadi.diagnosis.residual.unexplained import (
    SmoothScreen,
    Unexplained,
    find_unexplained,
)
from lieid_casadi.diagnosis.screening.baseline import with_groups
from lieid_casadi.diagnosis.screening.context import ScreeningContext
from lieid_casadi.diagnosis.screening.evidence import HypothesisFamily
from lieid_casadi.diagnosis.screening.screen import screen
from lieid_casadi.diagnosis.search.candidate_selection import (
    by_contribution,
    schwarz_penalty,
    simplest_equivalent,
)
from lieid_casadi.diagnosis.search.forward_selection import best_set
from lieid_casadi.diagnosis.search.rivals import find_rivals
from lieid_casadi.diagnosis.search.search_problem import Offer, SearchProblem
from lieid_casadi.diagnosis.search.search_results import Significance


def search(
    problem: SearchProblem, most_steps: int, limit: str, report: Callable[[float], None]
) -> None:
    """Add effects to a problem until none is accepted.

    Parameters
    ----------
    problem : SearchProblem
    most_steps : int
        After which the search ends.
    limit : str
        Name of this limit, added to ``limits_reached`` if it ends the search.
    report : callable
        Called with the fraction done, 0 to 1.
    """
    for step in range(most_steps):
        report(step / most_steps)
        if problem.is_finished() or not add_effect(problem):
            return
        problem.update()
    if not problem.is_finished():
        problem.limits_reached.append(limit)


def add_effect(problem: SearchProblem) -> bool:
    """Offer the best candidates to a problem until it accepts one; return whether it did."""
    options = problem.options
    context, groups = _select(problem)
    candidates = context.candidates.whitened(problem.white, context.runs)
    baseline = problem.baseline(problem.white, candidates)
    blocks = context.time_blocks(problem.white, options.block_duration)
    folds = context.folds(problem.white)
    for selected in by_contribution(candidates, baseline, groups, options):
        others = [g for g in groups if g != selected]
        with_others = with_groups(baseline, candidates, others)
        rivals = find_rivals(
            candidates, with_others, selected, excluded=others, blocks=blocks, options=options
        )
        group, rivals = simplest_equivalent(candidates, with_others, selected, rivals, folds)
        offer = Offer(
            context,
            candidates,
            baseline,
            group,
            tuple(others),
            _significance(problem, context, group, others),
            tuple((candidates.owner(r.group), r.kind) for r in rivals),
        )
        if problem.accept(offer):
            return True
    return False


def _select(problem: SearchProblem) -> tuple[ScreeningContext, list[int]]:
    """Return the groups that together explain most, and the context with the refined grids."""
    options, context = problem.options, problem.context
    refined: set[str] = set()
    for remaining in range(options.refinement_rounds + 1, -1, -1):
        candidates = context.candidates.whitened(problem.white, context.runs)
        baseline = problem.baseline(problem.white, candidates)
        penalty = schwarz_penalty(baseline, problem.least_gain)
        excluded = problem.excluded(candidates)
        groups = best_set(candidates, baseline, penalty, options, excluded)
        if not remaining:
            break
        grids = problem.refined_grids(candidates, baseline, groups, refined)
        if not grids:
            break
        refined |= {candidates.owners[k].placement.label for k in grids}
        context = context.with_grids(grids)
    return context, groups


def _significance(
    problem: SearchProblem, context: ScreeningContext, group: int, others: Sequence[int]
) -> Significance:
    """Return the evidence for a group in addition to the model and the other selected groups.

    The gain is divided by the dispersion of the whitened residual, if that is above one.
    """
    candidates = context.candidates.whitened(problem.coloured, context.runs)
    baseline = problem.baseline(problem.coloured, candidates)
    with_others = with_groups(baseline, candidates, others)
    screening = screen(candidates, with_others, None)
    after = with_others.with_columns(candidates.stacked(group))
    rows = int(after.ends[len(context.runs)])  # rows of a prior follow
    freedom = max(after.rows - after.rank, 1)
    dispersion = max(float(np.sum(after.residual[:rows] ** 2)) / freedom, 1.0)
    gain = float(screening.gain[group]) / dispersion
    family = HypothesisFamily.of(
        screening,
        seed=problem.seed,
        draws=problem.options.bootstrap_draws,
        further=context.scanned,
    )
    return Significance(family.log10_p(gain, int(screening.rank[group])), gain, rows)


def unexplained_parts(problem: SearchProblem) -> tuple[Unexplained, ...]:
    """Return what smooth functions explain of the residual of all accepted effects."""
    context = problem.context
    plain, coloured = (
        SmoothScreen(context.smooth.whitened(noise, context.runs), problem.current_baseline(noise))
        for noise in (problem.white, problem.coloured)
    )
    folds = context.folds(problem.white)
    return find_unexplained(plain, coloured, folds, options=problem.options, seed=problem.seed)
