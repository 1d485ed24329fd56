"""Candidates that could take the place of an accepted effect in the final model."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from lieid_casadi.diagnosis.screening.baseline import Baseline
from lieid_casadi.diagnosis.screening.candidate_columns import CandidateColumns
from lieid_casadi.diagnosis.screening.candidate_evaluation import evaluate_candidates
from lieid_casadi.diagnosis.screening.candidates import Candidate
from lieid_casadi.diagnosis.screening.screen import Screening, SelectionState, screen
from lieid_casadi.diagnosis.search.candidate_selection import at_estimate
from lieid_casadi.diagnosis.search.fixed_model import fixed_parameters
from lieid_casadi.diagnosis.search.parameter_checks import implausible_size
from lieid_casadi.diagnosis.search.search_problem import SearchProblem
from lieid_casadi.diagnosis.search.search_results import AcceptedEffect
from lieid_casadi.effects import ArmEffect

Array = NDArray[np.float64]
Columns = CandidateColumns[Candidate]


@dataclass(frozen=True, eq=False)
class Alternatives:
    """An accepted effect and the candidates that could take its place beside all other effects.

    Every candidate is evaluated at the best point of its grid, or at its own estimate if its
    columns depend on its coefficients; so is the effect.

    Attributes
    ----------
    effect : AcceptedEffect
    without : Baseline
        Of the final model without the effect.
    columns : (R, k)
        Of the effect, whitened.
    own_gain : float
        Fall of the sum of squares by the effect.
    alone, both : Screening
        Of the candidates, one group each, without the effect and in addition to it.
    """

    effect: AcceptedEffect
    without: Baseline
    columns: Array
    own_gain: float
    alone: Screening
    both: Screening

    @property
    def candidates(self) -> Columns:
        """The candidates, one group each, whitened."""
        return self.alone.candidates


def alternatives(effect: AcceptedEffect, problem: SearchProblem) -> Alternatives:
    """Return the candidates that could take the place of an accepted effect.

    They explain a part of what the effect explains, or are among those that explain most on its
    joint, of which pairs are formed. Candidates with physically impossible values, those rejected
    for good, and variants of accepted effects are none.
    """
    options, own = problem.options, effect.candidate
    without = problem.baseline_without(own.placement)
    columns = _own_columns(effect, problem, without)
    after = without.with_columns(columns)
    own_gain = without.fall(after)
    every = problem.candidates(problem.white)
    gain = screen(every, without, options).gain
    taken = {(a.candidate.name, a.candidate.joints) for a in problem.accepted}
    best: dict[int, int] = {}
    on_joint = 0
    for group in map(int, np.argsort(-gain)):
        candidate, k = every.owner(group), int(every.owner_index[group])
        out = k in best or (candidate.name, candidate.joints) in taken
        if gain[group] <= 0.0 or out or problem.is_excluded(candidate):
            continue
        here = candidate.joint == own.joint and not own.reaches_all
        paired = here and on_joint < options.most_rivals + options.paired_candidates
        if gain[group] >= options.least_rival_gain * own_gain or paired:
            best[k] = int(every.point[group])
            on_joint += here
    wanted = [
        replace(every.owners[k], grid=every.owners[k].grid[[point]]) for k, point in best.items()
    ]
    candidates = _at_estimates(wanted, problem, without)
    possible = [
        candidate
        for group, candidate in enumerate(candidates.owners)
        if _is_possible(candidates, group, without)
    ]
    if len(possible) < len(wanted):
        candidates = _evaluated(possible, problem)
    return Alternatives(
        effect, without, columns, own_gain,
        screen(candidates, without, options),
        screen(candidates, after, options),
    )  # fmt: skip


def _own_columns(effect: AcceptedEffect, problem: SearchProblem, without: Baseline) -> Array:
    """Return the columns (R, k) of an accepted effect, at its estimate without rounding by noise.

    The noise that weights the rows of a fit differs from that of the screening; the effect is
    compared with others at the estimate of the same screening.
    """
    columns = problem.columns_of(effect.candidate.placement, problem.white)
    own = effect.candidate.effect
    if not problem.refitted or not isinstance(own, ArmEffect) or own.shapes:
        return columns
    fitted = np.array([[effect.parameters[c.name] for c in own.coefficients]])
    found = _at_estimates([replace(effect.candidate, grid=fitted)], problem, without)
    return found.stacked(0)


def _evaluated(wanted: Sequence[Candidate], problem: SearchProblem) -> Columns:
    """Return the columns of candidates, whitened by the white noise."""
    context = problem.context
    columns = evaluate_candidates(wanted, context.signals, context.runs, context.store)
    return columns.whitened(problem.white, context.runs)


def _at_estimates(
    wanted: Sequence[Candidate], problem: SearchProblem, without: Baseline
) -> Columns:
    """Return candidates with one grid point; columns that depend on coefficients at the estimate.

    Parameters
    ----------
    wanted : sequence of Candidate
        With one grid point each.
    problem : SearchProblem
    without : Baseline
        To which each of them is added alone.
    """
    options, wanted = problem.options, list(wanted)
    candidates = _evaluated(wanted, problem)
    for _ in range(options.refinement_rounds):
        state = SelectionState(candidates, without, options)
        grids = {
            k: at_estimate(state, k, [], options.coefficient_tolerance) for k in range(len(wanted))
        }
        moved = {k: grid for k, grid in grids.items() if grid is not None}
        if not moved:
            break
        wanted = [replace(c, grid=moved.get(k, c.grid)) for k, c in enumerate(wanted)]
        candidates = _evaluated(wanted, problem)
    return candidates


def _is_possible(candidates: Columns, group: int, without: Baseline) -> bool:
    """Whether the coefficients of a group, added to a baseline, are as small as on real arms."""
    candidate = candidates.owner(group)
    if all(np.isinf(c.limit) for c in candidate.effect.coefficients):
        return True
    values = fixed_parameters(candidate, candidate.grid[0], without, candidates.stacked(group))
    return not implausible_size(candidate.effect, values)
