"""The stepwise search for effects, for any problem that states baseline and acceptance.

Each round selects the candidates that together explain most of the residual (forward selection
with exchange, on grids that are refined around the best values), and offers them to the problem,
those of one effect on several joints together, the family with the largest contribution first.
The problem accepts the members of a family that pass all its tests, and families on other joints in
the same round. In place of a candidate with implausible values its rivals are offered. Without an
accepted family the search ends. Candidates that failed a statistical test are tried again after
the next acceptance, because the residual has changed.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

from lieid_casadi.diagnosis.residual.smooth_selection import SmoothScreen, find_unexplained
from lieid_casadi.diagnosis.residual.unexplained import Unexplained
from lieid_casadi.diagnosis.screening.screen import SelectionState
from lieid_casadi.diagnosis.search.candidate_selection import schwarz_penalty
from lieid_casadi.diagnosis.search.forward_selection import best_set
from lieid_casadi.diagnosis.search.search_problem import SearchProblem
from lieid_casadi.diagnosis.search.search_round import SearchRound
from lieid_casadi.identification.uncertainty.noise_model import Noise

#: Part of the remaining progress that one round is shown as; their number is not known before.
SHOWN_PER_ROUND = 0.2


def search(
    problem: SearchProblem, most_steps: int, limit: str, report: Callable[[str, float], None]
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
        Called with the last step and the fraction done, 0 to 1.
    """
    left, last = 1.0, "no effect added yet"
    while not problem.is_finished():
        report(last, 1.0 - left)
        if len(problem.accepted) >= most_steps:
            problem.limits_reached.append(limit)
            return
        before = len(problem.accepted)
        if not add_families(problem):
            return
        last, left = _progress(problem, before), left * (1.0 - SHOWN_PER_ROUND)
        problem.reconsider()
        problem.update()


def _progress(problem: SearchProblem, before: int) -> str:
    """Return the number of steps, the effects added last, and the held-out error on a joint."""
    added = problem.accepted[before:]
    first = added[0]
    labels = ", ".join(a.candidate.placement.label for a in added)
    return (
        f"step {len(problem.accepted)}: {labels}; error on joint {first.joint + 1} "
        f"{first.errors[1, first.joint]:.3g} N·m"
    )


def add_families(problem: SearchProblem) -> bool:
    """Offer the best candidates to a problem; return whether it accepted some.

    Families on other joints than those accepted before them are accepted in the same round: they
    explain different rows. An effect that reaches all joints is accepted alone.
    """
    selected, taken = _selected(problem), set[int]()
    everything = set(range(len(problem.context.runs)))
    first = len(problem.accepted)
    for members in selected.families():
        owners = [selected.state.candidates.owner(g) for g in members]
        reached = everything if any(c.reaches_all for c in owners) else {c.joint for c in owners}
        if taken & reached or problem.is_finished():
            continue
        before = len(problem.accepted)
        _offer_family(problem, selected, members)
        for accepted in problem.accepted[before:]:
            c = accepted.candidate
            taken |= everything if c.reaches_all else {c.joint}
    return len(problem.accepted) > first


def _offer_family(problem: SearchProblem, selected: SearchRound, members: Sequence[int]) -> None:
    """Offer the members of a family, and the rivals of those with implausible values."""
    offers = {o.candidate.placement.label: o for o in map(selected.offer, members)}
    if problem.accept(list(offers.values())):
        return
    implausible = [offer for offer in offers.values() if problem.is_excluded(offer.candidate)]
    for rival in (rival for offer in implausible for rival in selected.rivals_of(offer)):
        if problem.accept([rival]):
            return


def _selected(problem: SearchProblem) -> SearchRound:
    """Return the groups that together explain most, on grids refined around the best values."""
    options, context = problem.options, problem.context
    groups: Sequence[int] = ()
    refined: set[str] = set()
    for remaining in range(options.refinement_rounds + 1, -1, -1):
        candidates = (
            problem.candidates(problem.white)
            if context is problem.context
            else context.candidates.whitened(problem.white, context.runs)
        )
        baseline = problem.baseline(problem.white, candidates)
        state = SelectionState(candidates, baseline, options)
        penalty = schwarz_penalty(baseline, problem.least_gain)
        groups = best_set(state, penalty, options, problem.excluded(candidates))
        grids = problem.refined_grids(state, groups, refined) if remaining else {}
        if not grids:
            break
        refined |= {candidates.owners[k].placement.label for k in grids}
        context = context.with_grids(grids)
    return SearchRound(problem, context, state, groups)


def unexplained_parts(problem: SearchProblem, coloured: Sequence[Noise]) -> tuple[Unexplained, ...]:
    """Return what smooth functions explain of the residual of all accepted effects.

    Parameters
    ----------
    problem : SearchProblem
    coloured : sequence of Noise
        Autoregressive noise of each joint, for p-values.
    """
    context = problem.context
    plain, whitened = (
        SmoothScreen(context.smooth.whitened(noise, context.runs), problem.current_baseline(noise))
        for noise in (problem.white, coloured)
    )
    folds = context.folds(problem.white)
    return find_unexplained(plain, whitened, folds, options=problem.options, seed=problem.seed)
