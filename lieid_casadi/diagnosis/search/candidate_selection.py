"""Order and representatives of selected groups, and their shape parameters."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from lieid_casadi.diagnosis.options import Penalty
from lieid_casadi.diagnosis.screening.baseline import Baseline
from lieid_casadi.diagnosis.screening.candidate_columns import CandidateColumns
from lieid_casadi.diagnosis.screening.candidates import Candidate
from lieid_casadi.diagnosis.screening.cross_validation import cross_validated_gain
from lieid_casadi.diagnosis.screening.screen import SelectionState
from lieid_casadi.diagnosis.search.rivals import RivalGroup
from lieid_casadi.effects import ArmEffect
from lieid_casadi.identification.regression.variable_projection import ShapeRange

Array = NDArray[np.float64]
#: Part of a unit column outside the model's span, below which its coefficient is not fitted.
LEAST_OWN_PART = 1e-6


def schwarz_penalty(baseline: Baseline, part: float) -> Penalty:
    """Return Schwarz's penalty per parameter (Ann. Statist. 1978), with a least part of rows."""
    return Penalty(per_parameter=float(np.log(max(baseline.rows, 2))), part=part)


def by_contribution(state: SelectionState, groups: Sequence[int]) -> list[int]:
    """Return the selected groups, the one whose removal costs most first."""
    contribution = [state.given([h for h in groups if h != g]).gain[g] for g in groups]
    return [groups[k] for k in np.argsort(-np.array(contribution))] if groups else []


def simplest_equivalent(
    candidates: CandidateColumns[Candidate],
    with_others: Baseline,
    group: int,
    rivals: list[RivalGroup],
    folds: NDArray[np.intp],
) -> tuple[int, list[RivalGroup]]:
    """Return the simplest of a group and its rivals, and the others.

    The simplest has the fewest parameters, linear ones counting less than shape parameters;
    among equals it has the least error in blocked cross-validation.

    Parameters
    ----------
    candidates : CandidateColumns
        Whitened as the baseline is.
    with_others : Baseline
        With the other selected groups.
    group : int
    rivals : list of RivalGroup
    folds : (R,) int
        Fold of each row.
    """
    if not rivals:
        return group, rivals
    gains = {
        g: cross_validated_gain(candidates.stacked(g), with_others, folds)
        for g in [group, *(r.group for r in rivals)]
    }
    owners = {g: candidates.owner(g) for g in gains}
    parameters = {g: (c.parameters, len(c.effect.shapes)) for g, c in owners.items()}
    best = min(gains, key=lambda g: (*parameters[g], -gains[g]))
    if best == group:
        return group, rivals
    kind = next(r.kind for r in rivals if r.group == best)
    rest = [r for r in rivals if r.group != best]
    return best, [RivalGroup(group, kind, gains[group]), *rest]


def grid_peaks(candidates: CandidateColumns[Candidate], gain: Array, part: float) -> list[int]:
    """Return the groups that are peaks of their grid with at least a part of the best gain.

    Parameters
    ----------
    candidates : CandidateColumns
    gain : (G,)
    part : float
        0 to 1.
    """
    same = candidates.owner_index[1:] == candidates.owner_index[:-1]
    rises = np.append(same & (gain[1:] > gain[:-1]), False)
    falls = np.append(False, same & (gain[:-1] > gain[1:]))
    high = gain >= part * gain.max(initial=0.0)
    return [int(g) for g in np.flatnonzero(high & ~rises & ~falls)]


def refined_shapes(candidates: CandidateColumns[Candidate], gain: Array, group: int) -> Array:
    """Return the shape parameters (s,) of a group.

    A single one is placed at the peak of the parabola through the gains of its grid point and
    the neighbouring points.

    Parameters
    ----------
    candidates : CandidateColumns
    gain : (G,)
    group : int
    """
    candidate, point = candidates.owner(group), int(candidates.point[group])
    shapes = candidate.grid[point, : len(candidate.effect.shapes)]
    if len(shapes) != 1 or not 0 < point < len(candidate.grid) - 1:
        return np.asarray(shapes)
    before, here, after = gain[group - 1 : group + 2]
    curvature = before - 2.0 * here + after
    if not 0.0 < max(before, after) <= here or curvature >= 0.0:
        return np.asarray(shapes)
    ranges = ShapeRange.of(candidate.effect.shapes)
    low, middle, high = ranges.place(candidate.grid[point - 1 : point + 2])[:, 0]
    shift = 0.5 * (before - after) / curvature
    return np.asarray(ranges.shapes(np.array([middle + shift * 0.5 * (high - low)])))


def with_possible_rivals(
    state: SelectionState, groups: Sequence[int], part: float
) -> Iterator[tuple[int, list[int]]]:
    """Yield the selected groups and those that could take their places, each with its others.

    Of every candidate with at least a part of a selected group's gain this is the best group.

    Parameters
    ----------
    state : SelectionState
    groups : sequence of int
        Selected together.
    part : float
        0 to 1.
    """
    owner = state.candidates.owner_index
    for g in groups:
        others = [other for other in groups if other != g]
        gain = state.given(others).gain
        seen = set[int]()
        for group in map(int, np.argsort(-gain)):
            if gain[group] <= 0.0 or gain[group] < part * gain[g]:
                break
            if int(owner[group]) not in seen:
                seen.add(int(owner[group]))
                yield group, others


def at_estimate(
    state: SelectionState, group: int, others: Sequence[int], tolerance: float
) -> Array | None:
    """Return the grid (1, c) of a group's estimated coefficients, for columns that depend on them.

    Only at its own estimate is a column times the coefficient what the effect does. None for
    columns that do not depend on coefficients, or are evaluated at the estimate.

    Parameters
    ----------
    state : SelectionState
    group : int
    others : sequence of int
        The other selected groups.
    tolerance : float
        Relative change of the coefficients that counts.
    """
    candidates = state.candidates
    candidate = candidates.owner(group)
    if not isinstance(candidate.effect, ArmEffect) or candidate.effect.shapes:
        return None
    columns = candidates.stacked(group)
    values = state.with_groups(others).coefficients(columns, least=LEAST_OWN_PART)
    change = np.linalg.norm(values - candidate.grid[int(candidates.point[group])])
    return values[None] if change > tolerance * np.linalg.norm(values) else None
