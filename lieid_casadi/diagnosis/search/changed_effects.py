"""Which changes explain a new recording beside a model that is kept: one after another."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from itertools import product

import numpy as np
from numpy.typing import NDArray

from lieid_casadi.diagnosis.diagnosis import Evidence, Step
from lieid_casadi.diagnosis.residual.unexplained import Unexplained, smooth_columns, unexplained
from lieid_casadi.diagnosis.screening.candidates import Candidate
from lieid_casadi.diagnosis.screening.context import Scene
from lieid_casadi.diagnosis.screening.screen import Baseline, screen
from lieid_casadi.diagnosis.search.candidate_selection import (
    BLOCK,
    FOLD,
    block_index,
    by_contribution,
    spokesman,
)
from lieid_casadi.diagnosis.search.evidence import Family
from lieid_casadi.diagnosis.search.forward_selection import (
    Price,
    best_set,
    column_stack,
    with_groups,
)
from lieid_casadi.diagnosis.search.missing_effects import LEVEL, ZOOMS
from lieid_casadi.diagnosis.search.parameter_checks import hardly_there
from lieid_casadi.diagnosis.search.pruning import STOOD_IN, stands_in, unexplained_beside
from lieid_casadi.diagnosis.search.rivals import FOLDS, cross_validated_gain, rivals_of
from lieid_casadi.effects import ArmEffect, Placement
from lieid_casadi.identification.uncertainty.noise_model import Noise

Array = NDArray[np.float64]
MISFIT = 1.15  # times what the fit's error reaches on other motion: more, and something has changed
WORTH = 0.1  # least fall of a joint's error that is worth a change
TINY = 1e-12  # of the largest variance: below it a number counts as that well known
UNSEEN = 1e-6  # of a column's norm
CLOSE = 0.01  # of a coefficient: nearer to it a column need not be evaluated again


class ChangeSearch:
    """Changes found so far, on rows of the new recordings."""

    def __init__(self, scene: Scene, noise: tuple[Noise, ...], seed: int) -> None:
        self.scene, self.noise, self.seed = scene, noise, seed
        self.null = np.array([each.spread for each in noise])
        self.plain = tuple(Noise.white(each.spread) for each in noise)
        self.bank = scene.bank.whitened(self.plain, scene.runs)
        self._accepted: list[tuple[int, bytes]] = []  # candidate, and the point of its grid
        self.baseline = _with_prior(scene, self.plain)
        self.kept = _kept(scene, self.plain)
        self.blocks = block_index(scene, self.plain, BLOCK)
        self.folds = block_index(scene, self.plain, FOLD) % FOLDS
        self.rejected: list[tuple[str, str]] = []

    @property
    def chosen(self) -> list[int]:
        """Groups of the bank that were accepted."""
        return [self._group(candidate, point) for candidate, point in self._accepted]

    def _group(self, candidate: int, point: bytes) -> int:
        grid = self.bank.candidates[candidate].grid
        (at,) = (k for k, row in enumerate(grid) if row.tobytes() == point)
        (group,) = np.flatnonzero((self.bank.candidate == candidate) & (self.bank.point == at))
        return int(group)

    def _key(self, group: int) -> tuple[int, bytes]:
        candidate = int(self.bank.candidate[group])
        return candidate, self.bank.candidates[candidate].grid[self.bank.point[group]].tobytes()

    def next_step(self) -> Step | None:
        """Return the next change, or None."""
        barred = np.zeros(len(self.bank.candidates), dtype=bool)
        out = {label for label, _ in self.rejected}
        for k, candidate in enumerate(self.bank.candidates):
            barred[k] = candidate.placement.label in out
        for g in self.chosen:
            barred[self.bank.candidate[g]] = True
        high = self._high()
        found = self._best(barred) if high.any() else []
        here = with_groups(self.baseline, self.bank, self.chosen)
        for winner in by_contribution(self.bank, here, found):
            others = [g for g in found if g != winner]
            step = self._tried(here, winner, others, high)
            if step is not None:
                return step
        return None

    def _best(self, barred: NDArray[np.bool_]) -> list[int]:
        """Return the groups that together explain most, on grids refined where it matters."""
        for _ in range(ZOOMS + 1):
            here = with_groups(self.baseline, self.bank, self.chosen)
            price = Price(each=float(np.log(max(here.rows, 2))), part=WORTH)
            found = best_set(self.bank, here, price, barred)
            grids = self._finer(here, found)
            if not grids:
                break
            self.scene = self.scene.with_grids(grids)
            self.bank = self.scene.bank.whitened(self.plain, self.scene.runs)
        else:
            found = best_set(self.bank, here, price, barred)
        return found

    def _finer(self, here: Baseline, found: Sequence[int]) -> dict[int, Array]:
        """Return grids with more points beside the groups found, where there are any."""
        grids = {}
        for g in found:
            k, point = int(self.bank.candidate[g]), int(self.bank.point[g])
            candidate = self.bank.candidates[k]
            if candidate.effect.shapes:
                grids[k] = candidate.zoomed([point]).grid
            elif isinstance(candidate.effect, ArmEffect):
                beside = with_groups(here, self.bank, [other for other in found if other != g])
                values = _solved(beside, column_stack(self.bank, g))
                if np.linalg.norm(values - candidate.grid[point]) > CLOSE * np.linalg.norm(values):
                    grids[k] = np.vstack([candidate.grid, values])
        return grids

    def _tried(
        self, here: Baseline, winner: int, others: list[int], high: NDArray[np.bool_]
    ) -> Step | None:
        rivals = rivals_of(self.bank, here, others, winner, self.blocks)
        beside = with_groups(here, self.bank, others)
        winner, rivals = spokesman(self.bank, beside, winner, rivals, self.folds)
        candidate = self.bank.candidates[self.bank.candidate[winner]]
        label = candidate.placement.label
        columns = column_stack(self.bank, winner)
        before, after = self._misfit(self.chosen), self._misfit([*self.chosen, winner])
        fall = 1.0 - after / before
        held = cross_validated_gain(columns, here, self.folds)
        log10_p, rows = self._evidence(winner, others)
        joint = int(np.argmax(np.where(high, fall, -np.inf)))
        shapes = zip(candidate.effect.shapes, candidate.grid[self.bank.point[winner]], strict=False)
        if any(hardly_there(s, x, self.scene.segments, candidate.joint) for s, x in shapes):
            self.rejected.append((label, "its shape is less than motion shows"))
            return None
        if log10_p > np.log10(LEVEL):
            self.rejected.append((label, f"family-wise p = {10.0**log10_p:.2g}"))
            return None
        if held <= 0.0 or not fall[joint] >= WORTH:
            reason = f"error falls by {100 * fall[joint]:.1f} % only where it was raised"
            self.rejected.append((label, reason))
            return None
        self._accepted.append(self._key(winner))
        sizes = self.null * after
        return Step(
            label=label,
            effect=candidate.name,
            joints=candidate.joints,
            parameters=self._values(candidate, here, columns, winner),
            rms_train=None,
            rms_test=sizes,
            moving=sizes,
            evidence=Evidence(
                log10_p,
                rows,
                float(self.null[joint] * np.sqrt(max(before[joint] ** 2 - after[joint] ** 2, 0.0))),
                float(self.null[joint] * before[joint]),
                float(sizes[joint]),
                None,
            ),
            indistinguishable=tuple(
                (self.bank.candidates[self.bank.candidate[r.group]], r.kind) for r in rivals
            ),
        )

    def _values(
        self, candidate: Candidate, here: Baseline, columns: Array, group: int
    ) -> dict[str, float]:
        values = _solved(here, columns)
        named = {
            c.name: float(v) for c, v in zip(candidate.effect.coefficients, values, strict=True)
        }
        shapes = candidate.grid[self.bank.point[group]][: len(candidate.effect.shapes)]
        return named | {
            s.name: float(v) for s, v in zip(candidate.effect.shapes, shapes, strict=True)
        }

    def errors(self) -> Array:
        """Return each joint's error (n,) on the rows of tests beside the changes so far, N·m."""
        return self.null * self._misfit(self.chosen)

    def _high(self) -> NDArray[np.bool_]:
        """Mark the joints (n,) whose error is larger than another motion makes it."""
        rises = np.array([each.motion_ratio for each in self.noise])
        return np.asarray(self._misfit(self.chosen) > MISFIT * rises)

    def _misfit(self, groups: Sequence[int]) -> Array:
        """Return each joint's error over the fit's held-out error (n,).

        The model's own numbers stay as they are; only what changed is fitted.
        """
        kept = with_groups(self.kept, self.bank, groups)
        rows = [kept.residual[kept.joint(j)] for j in range(len(self.plain))]
        return np.array([np.sqrt(np.mean(own**2)) if len(own) else 0.0 for own in rows])

    def _evidence(self, winner: int, others: Sequence[int]) -> tuple[float, int]:
        groups = [*self.chosen, *others]
        bank = self.scene.bank.whitened(self.noise, self.scene.runs)
        beside = with_groups(_with_prior(self.scene, self.noise), bank, groups)
        screening = screen(bank, beside, every=True)
        left = beside.with_columns(column_stack(bank, winner))
        rows = int(beside.ends[len(self.plain)])
        dispersion = max(float(np.mean(left.residual[:rows] ** 2)), 1.0)
        family = Family.of(screening, seed=self.seed, further=self.scene.scanned)
        gain = float(screening.gain[winner]) / dispersion
        return family.log10_p(gain, int(screening.rank[winner])), rows

    def stand_ins(self, left: Sequence[Unexplained]) -> list[Placement]:
        """Return changes that only resemble what the error follows."""
        whole = with_groups(self.baseline, self.bank, self.chosen)
        last = with_groups(self.kept, self.bank, self.chosen)
        smooth = self.scene.smooth
        smooth = smooth.whitened(self.plain, self.scene.runs)
        out = []
        for u, g in product(left, self.chosen):
            placement = self.bank.candidates[self.bank.candidate[g]].placement
            if placement.joint == u.joint and not placement.whole_arm:
                others = [h for h in self.chosen if h != g]
                without = with_groups(self.baseline, self.bank, others)
                columns = smooth_columns(smooth, u)
                if unexplained_beside(u, self.kept, last) and stands_in(whole, without, columns):
                    out.append(placement)
        return out

    def without(self, out: Collection[str]) -> tuple[Unexplained, ...]:
        """Take changes back, and return what smooth functions explain then."""
        self.rejected += [(label, STOOD_IN) for label in out]
        self._accepted = [
            (k, point)
            for k, point in self._accepted
            if self.bank.candidates[k].placement.label not in out
        ]
        return self.left_over()

    def beside(self) -> Baseline:
        """Return the rows beside the model and all changes found so far."""
        return with_groups(self.baseline, self.bank, self.chosen)

    def left_over(self) -> tuple[Unexplained, ...]:
        """Return what smooth functions explain where the error is still raised."""
        here = self.beside()
        high = self._high()
        if not high.any():
            return ()
        smooth = self.scene.smooth
        bank = self.scene.bank.whitened(self.noise, self.scene.runs)
        white = with_groups(_with_prior(self.scene, self.noise), bank, self.chosen)
        found = unexplained(
            smooth.whitened(self.plain, self.scene.runs),
            (smooth.whitened(self.noise, self.scene.runs), white),
            here,
            self.folds,
            seed=self.seed,
        )
        return tuple(u for u in found if high[u.joint])


def _solved(beside: Baseline, columns: Array) -> Array:
    """Return coefficients (k,) of columns (R, k); directions that no motion shows stay at zero."""
    rest = beside.padded(columns)
    rest = rest - beside.basis @ (beside.basis.T @ rest)
    size = np.linalg.norm(columns, axis=0)
    size[size == 0.0] = 1.0
    return np.asarray(np.linalg.lstsq(rest / size, beside.residual, rcond=UNSEEN)[0] / size)


def _kept(scene: Scene, noise: Sequence[Noise]) -> Baseline:
    """Return the residual's baseline beside a model whose numbers cannot move."""
    rows = zip(noise, scene.residual, scene.runs, strict=True)
    residuals = [n.whiten(residual, runs) for n, residual, runs in rows]
    ends = np.concatenate([[0], np.cumsum([len(r) for r in residuals])]).astype(np.intp)
    return Baseline(np.zeros((ends[-1], 0)), np.concatenate(residuals), ends)


def _with_prior(scene: Scene, noise: Sequence[Noise]) -> Baseline:
    """Return the residual's baseline: columns that may move within the fit's uncertainty."""
    fit = scene.fit
    count = len(fit.values) + len(fit.shapes)
    sizes, axes = np.linalg.eigh(fit.covariance[:count, :count])
    known = np.sqrt(np.maximum(sizes, TINY * max(float(sizes.max(initial=0.0)), 1e-300)))
    prior = (axes / known).T
    matrices = [n.whiten(m, r) for n, m, r in zip(noise, scene.columns, scene.runs, strict=True)]
    torques = [n.whiten(t, r) for n, t, r in zip(noise, scene.residual, scene.runs, strict=True)]
    return Baseline.of([*matrices, prior], [*torques, np.zeros(count)])
