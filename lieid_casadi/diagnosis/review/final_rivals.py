"""Rivals of the accepted effects in the final model."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from lieid_casadi.diagnosis.screening.candidates import Candidate
from lieid_casadi.diagnosis.screening.screen import screen
from lieid_casadi.diagnosis.search.rivals import rival_pairs, rivals_of_columns
from lieid_casadi.diagnosis.search.search_problem import SearchProblem
from lieid_casadi.diagnosis.search.search_results import AcceptedEffect


def with_final_rivals(effect: AcceptedEffect, problem: SearchProblem) -> AcceptedEffect:
    """Return an accepted effect with its rivals in the final model.

    These are candidates, and pairs of candidates on its joint, that could take its place beside
    all other accepted effects.
    """
    options, own = problem.options, effect.candidate
    candidates = problem.candidates(problem.white)
    without = problem.baseline_without(own.placement)
    columns = problem.columns_of(own.placement, problem.white)
    blocks = problem.context.time_blocks(problem.white, options.block_duration)
    taken = {(a.candidate.name, a.candidate.joints) for a in problem.accepted}  # and its variants
    excluded = {k for k, c in enumerate(candidates.owners) if (c.name, c.joints) in taken}
    alone = screen(candidates, without, options)
    both = screen(candidates, without.with_columns(columns), options)
    singles = rivals_of_columns(
        alone, both, without, columns, excluded=excluded, blocks=blocks, options=options,
        same_form={k for k, c in enumerate(candidates.owners) if _same_form(c, own)},
    )  # fmt: skip
    gain = alone.gain
    excluded |= {int(candidates.owner_index[r.group]) for r in singles}
    best: dict[int, int] = {}
    for group in map(int, np.argsort(-gain)):
        owner = int(candidates.owner_index[group])
        here = candidates.owners[owner].joint == own.joint and not own.reaches_all
        if gain[group] > 0.0 and here and owner not in excluded:
            best.setdefault(owner, group)
        if len(best) == options.paired_candidates:
            break
    pairs = rival_pairs(
        candidates, without, columns, parameters=own.parameters, tried=list(best.values()),
        blocks=blocks, options=options,
    )  # fmt: skip
    return replace(
        effect,
        rivals=tuple((candidates.owner(r.group), r.kind) for r in singles),
        rival_pairs=tuple(
            (candidates.owner(r.groups[0]), candidates.owner(r.groups[1])) for r in pairs
        ),
    )


def _same_form(candidate: Candidate, other: Candidate) -> bool:
    """Whether two candidates are effects of one family on the same joints."""
    family = candidate.effect.family
    return bool(family) and family == other.effect.family and candidate.joints == other.joints
