"""Rivals of accepted effects that are to be named in their place."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass

import numpy as np

from lieid_casadi.diagnosis.screening.baseline import Baseline
from lieid_casadi.diagnosis.screening.candidates import Candidate
from lieid_casadi.diagnosis.search.alternatives import alternatives
from lieid_casadi.diagnosis.search.block_bootstrap import Competition, Competitor, competition
from lieid_casadi.diagnosis.search.search_problem import SearchProblem
from lieid_casadi.diagnosis.search.search_results import AcceptedEffect, Replacement

COMMON_JOINTS = 2  # other joints with the same effect from which a common cause is assumed


@dataclass(frozen=True, eq=False)
class _Comparison:
    """An accepted effect and what competes with it for its place in the final model."""

    problem: SearchProblem
    effect: AcceptedEffect
    without: Baseline
    found: Competition

    def is_more_frequent(self, k: int) -> bool:
        """Whether a competitor is selected more often, and its held-out error is not larger."""
        own, rival = self.effect.candidate, self.found.others[k].candidate
        frequent = self._exceeds(k) and not self._has_common_cause(own, rival)
        return bool(frequent and self._holds(self.found.others[k], no_larger=True))

    def _exceeds(self, k: int) -> bool:
        """Whether a competitor wins more often by more than the error of as few repetitions."""
        now, then = self.found.selected, float(self.found.others_selected[k])
        options = self.problem.options
        deviation = np.sqrt((now + then - (then - now) ** 2) / options.stability_draws)
        return bool(then - now > options.rival_deviations * deviation)

    def is_common(self, k: int) -> bool:
        """Whether a rival is an effect of several other joints, and the accepted one of none."""
        own, rival = self.effect.candidate, self.found.others[k].candidate
        if rival.placement.label not in {c.placement.label for c, _ in self.effect.rivals}:
            return False
        common = self._has_common_cause(rival, own)
        return common and self._holds(self.found.others[k], no_larger=False)

    def _has_common_cause(self, candidate: Candidate, other: Candidate) -> bool:
        """Whether a candidate is an effect of several other joints, and another one of none."""
        same_joint = candidate.joints == other.joints == (candidate.joint,)
        theirs, ours = (
            _other_joints(self.problem, c.effect.label, c.joint) for c in (candidate, other)
        )
        return same_joint and theirs >= COMMON_JOINTS and not ours

    def _holds(self, rival: Competitor, *, no_larger: bool) -> bool:
        """Whether a rival holds on held-out data; if wanted, with an error that is not larger.

        The errors are compared on the joint where the effect counts and, by the whitened sum of
        squares, on all joints; both on the same held-out parts.
        """
        own, rows = self.found.own, self.problem.held_out_rows
        by_blocks = any(c.candidate.effect.per_recording for c in (own, rival))
        now, then = (rows.errors(c.columns, self.without, blocks=by_blocks) for c in (own, rival))
        if now.parts is not then.parts:
            now, then = (rows.errors(c.columns, self.without, blocks=True) for c in (own, rival))
        as_well = then.after[self.effect.joint] <= now.after[self.effect.joint]
        as_well &= then.gain.sum() >= now.gain.sum()
        return then.holds and (bool(as_well) or not no_larger)


def better_rival(
    problem: SearchProblem, effect: AcceptedEffect, tried: Collection[frozenset[str]]
) -> Replacement | None:
    """Return the rival that is to be named in place of an accepted effect, or None.

    An effect is accepted beside those that were accepted before it. In the final model another
    candidate may explain the same part of the residual better. It takes the effect's place if it
    is selected more often on resampled blocks of time, by more than the random error of these
    repetitions, where Schwarz's penalty counts for both, and if its held-out error is not larger.
    Of rivals that the data do not separate, the one that is an effect of several other joints
    takes the place of one that is an effect of no other joint: a common cause is more likely than
    a further one.

    Parameters
    ----------
    problem : SearchProblem
    effect : AcceptedEffect
        With its rivals in the final model.
    tried : collection of frozenset of str
        Labels of all effects of models that were fitted before: none is fitted again.
    """
    if not _may_have_one(problem, effect):
        return None
    place = alternatives(effect, problem)
    found = competition(place, problem)
    comparison = _Comparison(problem, effect, place.without, found)
    label = effect.candidate.placement.label
    others = frozenset(a.candidate.placement.label for a in problem.accepted) - {label}
    for k in found.ranked:
        rival = found.others[k].candidate
        name = rival.placement.label
        if others | {name} in tried:
            continue
        if comparison.is_more_frequent(k):
            why = (
                f"{name} is selected more often in its place "
                f"({100 * found.others_selected[k]:.0f} % and {100 * found.selected:.0f} % of the "
                "repetitions on resampled data), and its held-out error is not larger"
            )
        elif comparison.is_common(k):
            why = f"{name} fits as well, and {rival.effect.label} is an effect of other joints too"
        else:
            continue
        return Replacement(effect, rival, rival.grid[0, : len(rival.effect.shapes)], why)
    return None


def _may_have_one(problem: SearchProblem, effect: AcceptedEffect) -> bool:
    """Whether another candidate may be selected more often, or a rival be on other joints too."""
    own = effect.candidate
    counts = [_other_joints(problem, c.effect.label, own.joint) for c, _ in effect.rivals]
    return effect.selected < 0.5 or max(counts, default=0) >= COMMON_JOINTS


def _other_joints(problem: SearchProblem, label: str, joint: int) -> int:
    """Return on how many joints other than one an effect is accepted.

    Parameters
    ----------
    problem : SearchProblem
    label : str
        Of the effect, without a joint.
    joint : int
        From 0.
    """
    same = [a.candidate for a in problem.accepted if a.candidate.effect.label == label]
    return len({c.joint for c in same if c.joint != joint})
