"""Effects that explain part of an unexplained residual but are not in the model, and why."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from lieid_casadi.diagnosis.residual.projected_residual import ProjectedResidual
from lieid_casadi.diagnosis.residual.shapes import smooth_function
from lieid_casadi.diagnosis.residual.unexplained import PartialCandidate, Unexplained
from lieid_casadi.diagnosis.screening.screen import screen
from lieid_casadi.diagnosis.search.search_problem import SearchProblem
from lieid_casadi.diagnosis.wording import join_words

LEAST_PART, MOST_SHOWN = 0.25, 5  # of an unexplained part; candidates of each
CONTAINED = 0.9  # part of a formula's sum of squares that an effect explains which contains it
AS_WELL = 0.97  # of an unexplained part that an effect explains as well as smooth functions


def with_candidates(
    parts: Sequence[Unexplained], problem: SearchProblem, residual: ProjectedResidual
) -> tuple[Unexplained, ...]:
    """Return unexplained parts with the effects on their joint that explain part of them.

    A formula that an effect of the library contains is left out, as is one of a part that an
    effect explains as well as smooth functions: the effect is listed instead.

    Parameters
    ----------
    parts : sequence of Unexplained
        With their formulas.
    problem : SearchProblem
        With the accepted effects.
    residual : ProjectedResidual
        Of these.
    """
    described = []
    for part in parts:
        own = residual.baseline.residual[residual.baseline.joint(part.joint)]
        explained = part.fraction * float(own @ own)
        gains = _gains(part, problem, residual.baseline.residual)
        reasons = {r.candidate.placement.label: r.reason for r in problem.rejected}
        found = [
            PartialCandidate(
                label,
                label.partition(":")[0],
                joints,
                min(gain / explained, 1.0),
                reasons.get(label, _less_than_smooth(part, gain / explained)),
            )
            for label, (joints, gain) in gains.items()
            if gain >= LEAST_PART * explained
        ]
        found.sort(key=lambda c: -c.part)
        nearly_all = found and found[0].part >= AS_WELL
        contained = found[0].label if nearly_all else _containing_effect(part, problem, residual)
        described.append(
            replace(
                part,
                candidates=tuple(found[:MOST_SHOWN]),
                contained_in=contained,
                carries_over=part.carries_over and _holds(part, problem, residual),
                formula=None if contained else part.formula,
            )
        )
    return tuple(described)


def _gains(
    part: Unexplained, problem: SearchProblem, residual: NDArray[np.float64]
) -> dict[str, tuple[tuple[int, ...], float]]:
    """Return joints, and fall of the sum of squares (R,), by label of candidates on a joint."""
    candidates = problem.candidates(problem.white)
    baseline = replace(problem.current_baseline(problem.white), residual=residual)
    gain = screen(candidates, baseline, problem.options).gain
    taken = {a.candidate.placement.label for a in problem.accepted}
    found: dict[str, tuple[tuple[int, ...], float]] = {}
    for group in np.argsort(gain):
        c = candidates.owner(int(group))
        if c.joint == part.joint and not c.reaches_all and c.placement.label not in taken:
            found[c.placement.label] = c.joints, float(gain[group])
    return found


def _holds(part: Unexplained, problem: SearchProblem, residual: ProjectedResidual) -> bool:
    """Whether what would be printed as an effect reduces the error of held-out training data.

    Of a single recording, smooth functions are tried on short blocks of time alone
    (`ProjectedResidual.carries_over`): they need the whole range of their signals.
    """
    if part.formula is None:
        columns = smooth_function(part.joint, part.terms[0], residual)
    else:
        terms = part.formula.terms
        along = [np.column_stack([t.along(s) for t in terms]) for s in residual.signals]
        columns = residual.columns(part.joint, along)
    held_out = problem.held_out_rows.errors(columns, residual.baseline)
    return held_out.holds or (part.formula is None and not held_out.parts.recordings)


def _containing_effect(
    part: Unexplained, problem: SearchProblem, residual: ProjectedResidual
) -> str:
    """Return the label of the effect that explains a part's formula, or an empty text."""
    if part.formula is None:
        return ""
    terms = part.formula.terms
    along = [np.column_stack([t.along(s) for t in terms]) for s in residual.signals]
    torque = residual.columns(part.joint, along) @ np.array(part.formula.values)
    rest = residual.baseline.outside(torque[:, None])[:, 0]
    gains = _gains(part, problem, rest)
    best = max(gains, key=lambda label: gains[label][1], default="")
    return best if best and gains[best][1] >= CONTAINED * float(rest @ rest) else ""


def _less_than_smooth(part: Unexplained, share: float) -> str:
    """Return why a candidate that the search did not select is not in the model."""
    return (
        f"explains {100 * min(share, 1.0):.0f} % of what smooth functions of "
        f"{join_words(part.depends_on)} explain"
    )
