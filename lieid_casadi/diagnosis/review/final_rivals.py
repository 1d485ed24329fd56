"""Rivals of the accepted effects in the final model."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from lieid_casadi.diagnosis.screening.candidates import Candidate
from lieid_casadi.diagnosis.search.alternatives import Alternatives
from lieid_casadi.diagnosis.search.rivals import rival_pairs, rivals_of_columns
from lieid_casadi.diagnosis.search.search_problem import SearchProblem
from lieid_casadi.diagnosis.search.search_results import AcceptedEffect


def with_final_rivals(found: Alternatives, problem: SearchProblem) -> AcceptedEffect:
    """Return an accepted effect with its rivals in the final model.

    These are candidates, and pairs of candidates on its joint, that could take its place beside
    all other accepted effects.
    """
    options, effect, candidates = problem.options, found.effect, found.candidates
    own, without = effect.candidate, found.without
    blocks = problem.context.time_blocks(problem.white, options.block_duration)
    singles = rivals_of_columns(
        found.alone, found.both, without, found.columns,
        excluded=(), blocks=blocks, options=options,
        same_form={k for k, c in enumerate(candidates.owners) if _same_form(c, own)},
    )  # fmt: skip
    gain, excluded = found.alone.gain, {r.group for r in singles}
    paired = [
        group
        for group in map(int, np.argsort(-gain))
        if gain[group] > 0.0
        and candidates.owner(group).joint == own.joint
        and not own.reaches_all
        and group not in excluded
    ]
    pairs = rival_pairs(
        candidates, without, found.columns, parameters=own.parameters,
        tried=paired[: options.paired_candidates], blocks=blocks, options=options,
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
