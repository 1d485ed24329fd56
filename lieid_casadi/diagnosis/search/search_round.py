"""One round of the search: candidates, what was selected together, and the tests of each."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from lieid_casadi.diagnosis.screening.context import ScreeningContext
from lieid_casadi.diagnosis.screening.evidence import HypothesisFamily
from lieid_casadi.diagnosis.screening.screen import SelectionState, screen
from lieid_casadi.diagnosis.search.candidate_selection import by_contribution, simplest_equivalent
from lieid_casadi.diagnosis.search.rivals import find_rivals
from lieid_casadi.diagnosis.search.search_problem import Offer, SearchProblem
from lieid_casadi.diagnosis.search.search_results import Significance

Array = NDArray[np.float64]


class SearchRound:
    """Everything that the offers of one round share; each is computed once.

    Parameters
    ----------
    problem : SearchProblem
    context : ScreeningContext
        With the grids on which the groups were selected.
    state : SelectionState
        Of the candidates and the model, whitened by the white noise.
    groups : sequence of int
        Selected together.
    """

    def __init__(
        self,
        problem: SearchProblem,
        context: ScreeningContext,
        state: SelectionState,
        groups: Sequence[int],
    ) -> None:
        self.problem, self.context, self.state, self.groups = problem, context, state, list(groups)
        options = problem.options
        self._blocks = context.time_blocks(problem.white, options.block_duration)
        self._folds = context.folds(problem.white)

    def families(self) -> list[list[int]]:
        """Return the selected groups, those of one effect on single joints together.

        The family with the largest contribution is first.
        """
        families: dict[str, list[int]] = {}
        for group in by_contribution(self.state, self.groups):
            candidate = self.state.candidates.owner(group)
            single = len(candidate.joints) == 1 and not candidate.reaches_all
            name = candidate.effect.label if single else candidate.placement.label
            families.setdefault(name, []).append(group)
        return list(families.values())

    def rivals_of(self, offer: Offer) -> Iterator[Offer]:
        """Yield the rivals of an offer that are not excluded, each in its place."""
        candidates, gain = self.state.candidates, self.state.given(offer.others).gain
        for rival, _ in offer.rivals:
            if not self.problem.is_excluded(rival):
                label = rival.placement.label
                own = [k for k, c in enumerate(candidates.owners) if c.placement.label == label]
                groups = np.flatnonzero(candidates.owner_index == own[0])
                yield self.offer(int(groups[np.argmax(gain[groups])]), offer.others)

    def offer(self, selected: int, others: Sequence[int] | None = None) -> Offer:
        """Return a selected group, or the simplest of its equivalents, with its tests.

        Parameters
        ----------
        selected : int
        others : sequence of int, optional
            Groups that are selected together with it; by default the others of the round.
        """
        problem, candidates = self.problem, self.state.candidates
        if others is None:
            others = [g for g in self.groups if g != selected]
        out = problem.excluded(candidates)[candidates.owner_index]
        excluded = [int(g) for g in np.flatnonzero(out)]
        with_others = self.state.with_groups(others)
        rivals = find_rivals(
            self.state, others, selected, excluded=[*others, *excluded],
            blocks=self._blocks,
            options=problem.options,
        )  # fmt: skip
        group, rivals = simplest_equivalent(candidates, with_others, selected, rivals, self._folds)
        candidate = candidates.owner(group)
        return Offer(
            self.context,
            self.state,
            group,
            tuple(others),
            self.significance(group, others),
            tuple((candidates.owner(r.group), r.kind) for r in rivals),
            problem.held_out_rows.errors(
                candidates.stacked(group), with_others, blocks=candidate.effect.per_recording
            ),
        )

    def significance(self, group: int, others: Sequence[int]) -> Significance:
        """Return the evidence for a group in addition to the model and other groups.

        The gain is divided by the dispersion of the whitened residual on the joints where the
        group acts, if that is above one.
        """
        state = self._coloured
        gains = state.given(others)
        with_others = state.with_groups(others)
        columns = state.candidates.stacked(group)
        dispersion = with_others.dispersion(columns, len(self.context.runs))
        gain, rank = float(gains.gain[group]) / dispersion, int(gains.rank[group])
        rows = int(state.baseline.ends[len(self.context.runs)])  # rows of a prior follow
        return Significance(
            self._family.log10_p(gain, rank), gain, max(rank, 1), rows, self._family.tests,
            dispersion,
        )  # fmt: skip

    @cached_property
    def _coloured(self) -> SelectionState:
        problem = self.problem
        candidates = self.context.candidates.whitened(problem.coloured, self.context.runs)
        baseline = problem.baseline(problem.coloured, candidates)
        return SelectionState(candidates, baseline, None)

    @cached_property
    def _family(self) -> HypothesisFamily:
        """All candidates and grid points as one family of tests."""
        return HypothesisFamily.of(
            screen(self._coloured.candidates, self._coloured.baseline, None),
            seed=self.problem.seed,
            draws=self.problem.options.bootstrap_draws,
            further=self.context.scanned,
        )
