"""Effects that explain one training recording and not the others: what differs between them."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from lieid_casadi.diagnosis.screening.baseline import Baseline
from lieid_casadi.diagnosis.screening.candidate_columns import CandidateColumns, JointColumns
from lieid_casadi.diagnosis.screening.candidates import Candidate
from lieid_casadi.diagnosis.screening.evidence import HypothesisFamily
from lieid_casadi.diagnosis.screening.screen import SelectionState, screen
from lieid_casadi.diagnosis.search.candidate_selection import schwarz_penalty
from lieid_casadi.diagnosis.search.forward_selection import penalized_gain
from lieid_casadi.diagnosis.search.search_problem import SearchProblem
from lieid_casadi.diagnosis.search.search_results import Difference

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class _OneRecording:
    """The candidate that best explains one recording alone.

    Attributes
    ----------
    recording : int
    group : int
    score : float
        Its gain minus its penalty.
    columns : (R, k)
        Whitened, zero on the other recordings.
    """

    recording: int
    group: int
    score: float
    columns: Array


def recording_differences(problem: SearchProblem) -> tuple[Difference, ...]:
    """Return the effect that best explains what differs between the training recordings.

    The candidates are screened once more with columns that are zero on all recordings but one.
    The best one is a difference if it is significant, worth naming, explains little more with other
    coefficients on the other recordings, and more of its joint than a smooth function of the
    signals that is the same in all recordings.
    """
    found = _best_on_one(problem)
    return () if found is None else (_difference(problem, found),)


def leading_difference(problem: SearchProblem) -> tuple[Difference, tuple[Array, ...]] | None:
    """Return a difference that explains more than any effect of the arm, and its columns.

    Its columns (N_j, k) of each joint are not whitened, and zero on the other recordings. An effect
    of the arm, with the same coefficients in all recordings, explains more than on one alone.
    """
    found = _best_on_one(problem)
    if found is None:
        return None
    candidates, baseline = (
        problem.candidates(problem.white),
        problem.current_baseline(problem.white),
    )
    penalty = schwarz_penalty(baseline, problem.least_gain)
    common = SelectionState(candidates, baseline, problem.options).given([])
    of_the_arm = penalized_gain(common, np.diff(baseline.ends), penalty)
    if of_the_arm.max() >= found.score:
        return None
    context, held = problem.context, problem.held_out_rows.parts[0].held
    own = _only_on(context.candidates, held == found.recording)
    return _difference(problem, found), tuple(own.dense(found.group))


def _best_on_one(problem: SearchProblem) -> _OneRecording | None:
    parts = problem.held_out_rows.parts[0]
    if not parts.recordings:
        return None
    options, white = problem.options, problem.white
    candidates, baseline = problem.candidates(white), problem.current_baseline(white)
    penalty = schwarz_penalty(baseline, problem.least_gain)
    rows = np.diff(baseline.ends)
    states = [
        SelectionState(_only_on(candidates, parts.held == k), baseline, options)
        for k in range(len(parts.names))
    ]
    gains = [state.given([]) for state in states]
    scores = np.array([penalized_gain(each, rows, penalty) for each in gains])
    if not scores.size or not np.isfinite(scores).any():
        return None
    best, group = map(int, np.unravel_index(int(np.argmax(scores)), scores.shape))
    gain = float(gains[best].gain[group])
    columns = states[best].candidates.stacked(group)
    with_it = baseline.with_columns(columns)
    others = (state.candidates.stacked(group) for k, state in enumerate(states) if k != best)
    elsewhere = max(_gain(other, with_it) for other in others)
    if scores[best, group] <= 0.0 or elsewhere > options.least_rival_gain * gain:
        return None
    if _log10_p(problem, best, group) > np.log10(options.significance):
        return None
    if _is_the_same_in_all(problem, baseline, with_it):
        return None
    return _OneRecording(best, group, float(scores[best, group]), columns)


def _is_the_same_in_all(problem: SearchProblem, without: Baseline, with_it: Baseline) -> bool:
    """Whether a smooth function, the same in all recordings, explains as much of the joint.

    A torque outside the library may resemble an effect on one recording only.

    Parameters
    ----------
    problem : SearchProblem
    without, with_it : Baseline
        Without the effect on one recording, and with it.
    """
    rows = [without.joint(j) for j in range(len(problem.white))]
    fall = [np.sum(without.residual[r] ** 2) - np.sum(with_it.residual[r] ** 2) for r in rows]
    joint = int(np.argmax(fall))
    smooth = problem.context.smooth.whitened(problem.white, problem.context.runs)
    gains = screen(smooth, without, problem.options)
    penalty = schwarz_penalty(without, problem.least_gain)
    here = np.array([c.joint == joint for c in smooth.owners])[smooth.owner_index]
    scores = gains.gain - penalty.per_parameter * smooth.parameters
    return bool(scores[here].max(initial=-np.inf) >= fall[joint])


def _gain(columns: Array, baseline: Baseline) -> float:
    """Return the fall of the sum of squares when columns (R, k) are added to a baseline."""
    after = baseline.with_columns(columns).residual
    return float(np.sum(baseline.residual**2) - np.sum(after**2))


def _difference(problem: SearchProblem, found: _OneRecording) -> Difference:
    baseline = problem.current_baseline(problem.white)
    candidate = problem.candidates(problem.white).owner(found.group)
    values = baseline.coefficients(found.columns, least=1e-6)
    names = [c.name for c in candidate.effect.coefficients]
    return Difference(
        candidate.placement.label,
        candidate.name,
        candidate.joints,
        (problem.held_out_rows.parts[0].names[found.recording],),
        {name: float(value) for name, value in zip(names, values, strict=True)},
    )


def _log10_p(problem: SearchProblem, recording: int, group: int) -> float:
    """Return log₁₀ of the p-value of a group on one recording; the family has all recordings."""
    noise, context = problem.last_noise(), problem.context
    candidates, baseline = problem.candidates(noise), problem.current_baseline(noise)
    instants = context.held_out_rows(noise, noise).parts[0]
    only = _only_on(candidates, instants.held == recording)
    screening = screen(only, baseline, None)
    family = HypothesisFamily.of(
        screening, seed=problem.seed, draws=problem.options.bootstrap_draws, further=context.scanned
    )
    tests = HypothesisFamily(family.tests * len(instants.names))
    dispersion = baseline.dispersion(only.stacked(group), len(context.runs))
    return tests.log10_p(float(screening.gain[group]) / dispersion, int(screening.rank[group]))


def _only_on(
    candidates: CandidateColumns[Candidate], rows: NDArray[np.bool_]
) -> CandidateColumns[Candidate]:
    """Return the columns, zero except on some of the rows (R,)."""
    joints, first = [], 0
    for own in candidates.joints:
        last = first + len(own.matrix)
        joints.append(JointColumns(own.columns, own.matrix * rows[first:last, None]))
        first = last
    return replace(candidates, joints=tuple(joints))
