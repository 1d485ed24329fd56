"""Effects that explain one training recording and not the others: what differs between them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from lieid_casadi.diagnosis.options import Penalty
from lieid_casadi.diagnosis.screening.baseline import Baseline
from lieid_casadi.diagnosis.screening.candidate_columns import CandidateColumns, JointColumns
from lieid_casadi.diagnosis.screening.candidate_evaluation import evaluate_candidates
from lieid_casadi.diagnosis.screening.candidates import Candidate
from lieid_casadi.diagnosis.screening.evidence import HypothesisFamily
from lieid_casadi.diagnosis.screening.late_friction import p_beside_late_friction
from lieid_casadi.diagnosis.screening.screen import SelectionState, screen
from lieid_casadi.diagnosis.search.candidate_selection import schwarz_penalty
from lieid_casadi.diagnosis.search.forward_selection import penalized_gain
from lieid_casadi.diagnosis.search.pilot_noise import final_noise
from lieid_casadi.diagnosis.search.search_problem import SearchProblem
from lieid_casadi.diagnosis.search.search_results import Difference
from lieid_casadi.effects import ArmEffect
from lieid_casadi.model import Model

Array = NDArray[np.float64]
Columns = CandidateColumns[Candidate]


@dataclass(frozen=True, eq=False)
class _Found:
    """The candidate that best explains what differs between the recordings.

    Attributes
    ----------
    among : CandidateColumns
        Not whitened: the candidates, or the effects of the model.
    recordings : tuple of int
        A single one; all of them for an effect with other coefficients in each.
    group : int
    score : float
        Its gain minus its penalty.
    columns : (R, k)
        Whitened; those of each recording are zero on the others.
    """

    among: Columns
    recordings: tuple[int, ...]
    group: int
    score: float
    columns: Array


def recording_differences(problem: SearchProblem) -> tuple[Difference, ...]:
    """Return the effect that best explains what differs between the training recordings.

    The candidates and the model's own effects are screened with columns that are zero on all
    recordings but one, and effects that belong to a recording (a drift) with coefficients of their
    own in each.
    The best one is a difference if it is significant, worth naming, explains little more with other
    coefficients on the other recordings, and more of its joint than a smooth function of the
    signals that is the same in all recordings.
    """
    found = _best(problem)
    if found is None or not _is_significant(problem, found):
        return ()
    return _differences(problem, found)


def leading_difference(
    problem: SearchProblem,
) -> tuple[tuple[Difference, ...], tuple[Array, ...]] | None:
    """Return a difference that explains more than any effect of the arm, and its columns.

    Its columns (N_j, k) of each joint are not whitened, and zero on other recordings. An effect
    of the arm, with the same coefficients in all recordings, explains more than on one alone.
    """
    found = _best(problem)
    if found is None:
        return None
    candidates, baseline = (
        problem.candidates(problem.white),
        problem.current_baseline(problem.white),
    )
    penalty = schwarz_penalty(baseline, problem.least_gain)
    common = SelectionState(candidates, baseline, problem.options).given([])
    of_the_arm = penalized_gain(common, np.diff(baseline.ends), penalty)
    if of_the_arm.max() >= found.score or not _is_significant(problem, found):
        return None
    return _differences(problem, found), _columns(problem, found)


def _columns(problem: SearchProblem, found: _Found) -> tuple[Array, ...]:
    """Return the columns (N_j, k) of a difference on each joint, not whitened."""
    held = problem.held_out_rows.parts[0].held
    parts = [_only_on(found.among, held == k).dense(found.group) for k in found.recordings]
    return tuple(np.hstack(own) for own in zip(*parts, strict=True))


def _best(problem: SearchProblem) -> _Found | None:
    """Return what best explains a difference between the recordings."""
    parts = problem.held_out_rows.parts[0]
    if not parts.recordings:
        return None
    white, baseline = problem.white, problem.current_baseline(problem.white)
    penalty = schwarz_penalty(baseline, problem.least_gain)
    found = []
    own, candidates = _own_effects(problem), problem.context.candidates
    for among, whitened in (
        (candidates, problem.candidates(white)),
        (own, own.whitened(white, problem.context.runs)),
    ):
        if not len(among.size):
            continue
        only = [_only_on(whitened, parts.held == k) for k in range(len(parts.names))]
        found += [
            _on_one(problem, among, only, baseline, penalty),
            _on_each(among, only, baseline, penalty),
        ]
    best = max((f for f in found if f is not None), key=lambda each: each.score, default=None)
    if best is None or _is_the_same_in_all(problem, baseline, baseline.with_columns(best.columns)):
        return None
    return best


def _own_effects(problem: SearchProblem) -> Columns:
    """Return the columns of the model's effects on single joints, at their shape parameters."""
    context, fit = problem.context, problem.context.fit
    shapes = dict(zip((shape.label for shape in fit.model.shapes), fit.shapes, strict=True))
    own = []
    for placement in fit.model.placements:
        if not isinstance(placement.effect, ArmEffect):
            alone = Model.of_placements(fit.model.robot, (placement,))
            point = [float(shapes[shape.label]) for shape in alone.shapes]
            own.append(Candidate(placement, np.array(point).reshape(1, -1)))
    return evaluate_candidates(own, context.signals, context.runs, context.store)


def _on_one(
    problem: SearchProblem,
    among: Columns,
    only: Sequence[Columns],
    baseline: Baseline,
    penalty: Penalty,
) -> _Found | None:
    """Return the candidate that best explains one recording and little of the others.

    Parameters
    ----------
    problem : SearchProblem
    among : CandidateColumns
        Not whitened.
    only : sequence of CandidateColumns
        The same whitened, zero except on one recording each.
    baseline : Baseline
    penalty : Penalty
    """
    options, rows = problem.options, np.diff(baseline.ends)
    gains = [SelectionState(columns, baseline, options).given([]) for columns in only]
    scores = np.array([penalized_gain(each, rows, penalty) for each in gains])
    if not scores.size or not np.isfinite(scores).any():
        return None
    best, group = map(int, np.unravel_index(int(np.argmax(scores)), scores.shape))
    columns = only[best].stacked(group)
    with_it = baseline.with_columns(columns)
    others = (own.stacked(group) for k, own in enumerate(only) if k != best)
    elsewhere = max(_gain(other, with_it) for other in others)
    gain = float(gains[best].gain[group])
    if scores[best, group] <= 0.0 or elsewhere > options.least_rival_gain * gain:
        return None
    return _Found(among, (best,), group, float(scores[best, group]), columns)


def _on_each(
    among: Columns, only: Sequence[Columns], baseline: Baseline, penalty: Penalty
) -> _Found | None:
    """Return the effect that best explains all recordings with coefficients of its own in each.

    Only effects whose coefficients belong to a recording are considered; another effect with
    other coefficients in every recording is no effect of the arm.

    Parameters
    ----------
    among : CandidateColumns
        Not whitened.
    only : sequence of CandidateColumns
        The same whitened, zero except on one recording each.
    baseline : Baseline
    penalty : Penalty
    """
    first, rows, found = only[0], np.diff(baseline.ends), []
    for group in range(len(first.size)):
        candidate = first.owner(group)
        if not candidate.effect.per_recording:
            continue
        columns = np.hstack([own.stacked(group) for own in only])
        gain = _gain(columns, baseline)
        score = gain - penalty.per_parameter * candidate.parameters * len(only)
        if gain >= penalty.part * rows[candidate.joint] and score > 0.0:
            found.append(_Found(among, tuple(range(len(only))), group, score, columns))
    return max(found, key=lambda each: each.score, default=None)


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
    return baseline.fall(baseline.with_columns(columns))


def _differences(problem: SearchProblem, found: _Found) -> tuple[Difference, ...]:
    """Return one difference for each recording with coefficients of its own."""
    baseline = problem.current_baseline(problem.white)
    candidate: Candidate = found.among.owner(found.group)
    values = baseline.coefficients(found.columns, least=1e-6)
    names = [c.name for c in candidate.effect.coefficients]
    recordings = problem.held_out_rows.parts[0].names
    own = {p.label for p in problem.context.fit.model.placements}
    return tuple(
        Difference(
            candidate.placement.label,
            candidate.name,
            candidate.joints,
            (recordings[k],),
            {name: float(x) for name, x in zip(names, each, strict=True)},
            candidate.placement.label in own,
        )
        for k, each in zip(found.recordings, values.reshape(len(found.recordings), -1), strict=True)
    )


def _is_significant(problem: SearchProblem, found: _Found) -> bool:
    """Whether a difference is significant in a family of tests that has all recordings.

    Drifts of several recordings and other values of the model's own effects, an offset among them,
    are not attributed to the noise, which would resemble them.
    """
    noise, context, limit = problem.last_noise(), problem.context, problem.options.significance
    if len(found.recordings) > 1 or found.among is not context.candidates:
        noise = final_noise(context, _columns(problem, found))
    candidates, baseline = problem.candidates(noise), problem.current_baseline(noise)
    recordings = context.held_out_rows(noise, noise).parts[0]
    on = [recordings.held == k for k in found.recordings]
    family = HypothesisFamily.of(
        screen(_only_on(candidates, on[0]), baseline, None),
        seed=problem.seed,
        draws=problem.options.bootstrap_draws,
        further=context.scanned + len(context.fit.model.placements),
    )
    tests = HypothesisFamily(family.tests * len(recordings.names))
    among = found.among.whitened(noise, context.runs)
    columns = np.hstack([_only_on(among, rows).stacked(found.group) for rows in on])
    statistic, degrees, _ = baseline.evidence(columns, len(context.runs))
    log10_p = tests.log10_p(statistic, degrees)
    placement = found.among.owner(found.group).placement
    beside = p_beside_late_friction(baseline, columns, context, noise, placement, on)
    return log10_p <= float(np.log10(limit)) and beside <= limit


def _only_on(candidates: Columns, rows: NDArray[np.bool_]) -> Columns:
    """Return the columns, zero except on some of the rows (R,)."""
    joints, first = [], 0
    for own in candidates.joints:
        last = first + len(own.matrix)
        joints.append(JointColumns(own.columns, own.matrix * rows[first:last, None]))
        first = last
    return replace(candidates, joints=tuple(joints))
