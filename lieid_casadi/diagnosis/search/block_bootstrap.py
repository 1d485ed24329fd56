"""A block bootstrap of the screening in the final model: which candidate is selected how often."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lieid_casadi.diagnosis.options import DiagnosisOptions, Penalty
from lieid_casadi.diagnosis.screening.baseline import Baseline
from lieid_casadi.diagnosis.screening.candidates import Candidate
from lieid_casadi.diagnosis.search.alternatives import Alternatives
from lieid_casadi.diagnosis.search.candidate_selection import schwarz_penalty
from lieid_casadi.diagnosis.search.search_problem import SearchProblem

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Competitor:
    """Columns outside the model's span, and how many parameters they add.

    Attributes
    ----------
    candidate : Candidate
    columns : (R, k)
        On the rows of the joints.
    least : float
        Least gain for which the columns are selected.
    """

    candidate: Candidate
    columns: Array
    least: float

    def scores(self, residual: Array, blocks: NDArray[np.intp], counts: Array, per: float) -> Array:
        """Return the penalized gain (B,) of each resampling of the blocks; −inf if too small.

        Parameters
        ----------
        residual : (R,)
        blocks : (R,) int
            Block of time of each row.
        counts : (B, blocks)
            How often each block is drawn.
        per : float
            Penalty for each parameter.
        """
        k, size = self.columns.shape[1], counts.shape[1]
        both = np.column_stack([self.columns, residual])
        products = [
            np.bincount(blocks, weights=both[:, a] * both[:, b], minlength=size)
            for a in range(k)
            for b in range(k + 1)
        ]
        drawn = (counts @ np.array(products).T).reshape(len(counts), k, k + 1)
        inverse = np.linalg.pinv(drawn[:, :, :k], rcond=1e-8, hermitian=True)
        gain = np.einsum("ba,bac,bc->b", drawn[:, :, k], inverse, drawn[:, :, k])
        return np.where(gain >= self.least, gain - per * self.candidate.parameters, -np.inf)


@dataclass(frozen=True, eq=False)
class Competition:
    """How often an accepted effect and other candidates are selected in its place.

    Attributes
    ----------
    own : Competitor
    others : tuple of Competitor
    selected : float
        Fraction of the repetitions in which the effect is selected.
    others_selected : (C,)
        The same for each of the others.
    """

    own: Competitor
    others: tuple[Competitor, ...]
    selected: float
    others_selected: Array

    @property
    def ranked(self) -> list[int]:
        """Positions of the others, the one that is selected most often first."""
        return [int(k) for k in np.argsort(-self.others_selected, kind="stable")]


def competition(found: Alternatives, problem: SearchProblem) -> Competition:
    """Return how often an accepted effect is selected again, and what is selected in its place.

    The screening of the final model without the effect is repeated on resampled blocks of time;
    the model's own columns are projected out once. Candidates that no data can separate from the
    effect do not count.
    """
    options, without = problem.options, found.without
    blocks = problem.context.time_blocks(problem.white, options.block_duration)
    penalty = schwarz_penalty(without, problem.least_gain)
    own = _competitor(found.effect.candidate, found.columns, without, penalty, len(blocks))
    others = [
        _competitor(c, found.candidates.stacked(group), without, penalty, len(blocks))
        for group, c in _competing(found, options)
    ]
    random = np.random.default_rng([problem.seed, 67])
    size = int(blocks.max(initial=0)) + 1
    counts = random.multinomial(size, np.full(size, 1.0 / size), options.stability_draws)
    residual, per = without.residual[: len(blocks)], penalty.per_parameter
    scores = np.array(
        [c.scores(residual, blocks, counts.astype(float), per) for c in (own, *others)]
    )
    any_found = np.isfinite(scores.max(axis=0))
    wins = np.bincount(scores.argmax(axis=0)[any_found], minlength=len(scores))
    fractions = wins / options.stability_draws
    return Competition(own, tuple(others), float(fractions[0]), fractions[1:])


def _competing(found: Alternatives, options: DiagnosisOptions) -> list[tuple[int, Candidate]]:
    """Return the groups of candidates that could win against the effect.

    A candidate that explains as much in addition to the effect does not compete with it.
    """
    gain, further = found.alone.gain, found.both.gain
    wins = gain >= options.least_rival_gain * found.own_gain
    apart = further > options.most_rival_gain_in_addition * gain
    groups = np.flatnonzero(wins & ~apart & (found.both.rank > 0))
    order = groups[np.argsort(-gain[groups], kind="stable")][: options.most_rivals]
    return [(int(group), found.candidates.owner(group)) for group in order]


def _competitor(
    candidate: Candidate, columns: Array, baseline: Baseline, penalty: Penalty, rows: int
) -> Competitor:
    """Return columns outside a baseline's span on the rows of the joints."""
    least = penalty.part * float(np.diff(baseline.ends)[candidate.joint])
    return Competitor(candidate, baseline.outside(baseline.padded(columns))[:rows], least)
