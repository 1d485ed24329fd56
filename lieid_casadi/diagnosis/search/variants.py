"""Variants of accepted effects: another formula of the same effect, if it holds better."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lieid_casadi.diagnosis.screening.baseline import Baseline
from lieid_casadi.diagnosis.screening.candidate_evaluation import evaluate_candidates
from lieid_casadi.diagnosis.screening.candidates import Candidate, shape_grid
from lieid_casadi.diagnosis.screening.held_out import HeldOut
from lieid_casadi.diagnosis.screening.screen import screen
from lieid_casadi.diagnosis.search.search_problem import SearchProblem
from lieid_casadi.diagnosis.search.search_results import AcceptedEffect, Replacement
from lieid_casadi.effects import Effect, Placement
from lieid_casadi.effects.registry import make

Array = NDArray[np.float64]
NEAREST = 3  # values of a shape parameter that a variant shares with the accepted effect


@dataclass(frozen=True, eq=False)
class Variant:
    """A variant that holds on held-out data.

    Attributes
    ----------
    candidate : Candidate
    shapes : (s,)
        Shape parameters.
    held_out : HeldOut
        Errors without the effect and with the variant.
    """

    candidate: Candidate
    shapes: Array
    held_out: HeldOut


def better_variant(problem: SearchProblem, effect: AcceptedEffect) -> Replacement | None:
    """Return the variant of an accepted effect with the least held-out error, or None.

    The error of the effect's joint must be smaller by the least fall that counts for an effect,
    for each further parameter, beside all other accepted effects; and the variant must explain more
    than the effect on every held-out part that can judge either.
    """
    own = effect.candidate
    without = problem.baseline_without(own.placement)
    wanted = _variants(problem, effect)
    if not wanted:
        return None
    columns = problem.columns_of(own.placement, problem.white)
    now = problem.held_out_rows.errors(columns, without)
    joint = effect.joint

    def is_better(variant: Variant) -> bool:
        then = variant.held_out
        least = now.after[joint] * _least_ratio(problem, variant.candidate, own)
        if then.parts is not now.parts or then.after[joint] >= least:
            return False
        judged = now.judged | then.judged
        return bool(np.all(then.gain[judged] > now.gain[judged]))

    found = [v for v in _held_out(problem, wanted, without) if is_better(v)]
    if not found:
        return None
    best = min(found, key=lambda variant: float(variant.held_out.after[joint]))
    reason = f"{best.candidate.placement.label} has a smaller held-out error in its place"
    return Replacement(effect, best.candidate, best.shapes, reason)


def _least_ratio(problem: SearchProblem, variant: Candidate, own: Candidate) -> float:
    """Return the ratio of errors below which a variant is better."""
    return float((1.0 - problem.options.worth) ** max(variant.parameters - own.parameters, 1))


def _variants(problem: SearchProblem, accepted: AcceptedEffect) -> list[Candidate]:
    """Return the other variants of an effect that take the same place in a model.

    A variant that adds a signal which another accepted effect on the joint depends on is none: it
    would contain that effect, and the two would share one cause.
    """
    own = accepted.candidate
    used = {
        signal
        for other in problem.accepted
        if other is not accepted and other.candidate.joint == own.joint
        for signal in other.candidate.effect.signals
    }
    context, place = problem.context, own.placement
    tried = {r.candidate.placement.label for r in problem.rejected if r.final}
    found = []
    for option in ("", *own.effect.options):
        effect = make(f"{own.name}/{option}" if option else own.name)
        placement = Placement(effect, place.joint, place.source)
        alike = effect.replaces == own.effect.replaces and effect.whole_arm == own.effect.whole_arm
        shared = used & set(effect.signals) - set(own.effect.signals)
        if option == own.effect.option or not alike or shared or placement.label in tried:
            continue
        grid = shape_grid(effect, context.segments, place.joint, problem.options)
        found.append(Candidate(placement, _near(grid, effect, accepted.parameters)))
    return found


def _near(grid: Array, effect: Effect, fitted: Mapping[str, float]) -> Array:
    """Return the points of a grid (G, s) nearest to the shape parameters that are fitted already.

    Parameters
    ----------
    grid : (G, s)
    effect : Effect
    fitted : dict
        Parameters of the accepted effect by name.
    """
    for k, shape in enumerate(effect.shapes):
        if shape.name in fitted:
            distance = np.abs(np.log(grid[:, k] / fitted[shape.name]))
            grid = grid[distance <= np.unique(distance)[:NEAREST][-1]]
    return grid


def _held_out(
    problem: SearchProblem, wanted: Sequence[Candidate], without: Baseline
) -> list[Variant]:
    """Return the variants, at their best shape parameters, that hold on held-out data.

    Parameters
    ----------
    problem : SearchProblem
    wanted : sequence of Candidate
    without : Baseline
        Without the effect.
    """
    context = problem.context
    columns = evaluate_candidates(wanted, context.signals, context.runs, context.store)
    candidates = columns.whitened(problem.white, context.runs)
    gain = screen(candidates, without, problem.options).gain
    found = []
    for k, candidate in enumerate(wanted):
        groups = np.flatnonzero(candidates.owner_index == k)
        best = int(groups[np.argmax(gain[groups])])
        if gain[best] <= 0.0:
            continue
        held_out = problem.held_out_rows.errors(candidates.stacked(best), without)
        shapes = candidate.grid[candidates.point[best], : len(candidate.effect.shapes)]
        if held_out.holds:
            found.append(Variant(candidate, shapes, held_out))
    return found
