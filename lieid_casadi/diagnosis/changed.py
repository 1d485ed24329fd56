"""What has changed since a fit: the model is kept, its own held-out misfit is the null.

The fit's numbers may move within their uncertainties (rows of their own beside the measured
ones), so that what the fit never knew well is not taken for a change.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence

import numpy as np
from numpy.typing import NDArray

from lieid_casadi.comparison import compare
from lieid_casadi.diagnosis.candidates import Candidate
from lieid_casadi.diagnosis.choosing import BLOCK, FOLD, block_index, by_contribution, spokesman
from lieid_casadi.diagnosis.describing import described
from lieid_casadi.diagnosis.diagnosis import Diagnosis, Evidence, Step
from lieid_casadi.diagnosis.evidence import Family
from lieid_casadi.diagnosis.forward import Price, best_set, column_stack, with_groups
from lieid_casadi.diagnosis.pruning import STOOD_IN, stand_ins
from lieid_casadi.diagnosis.remainder import Remainder
from lieid_casadi.diagnosis.rivals import FOLDS, cross_validated_gain, rivals_of
from lieid_casadi.diagnosis.scene import Scene
from lieid_casadi.diagnosis.screening import Baseline, screen
from lieid_casadi.diagnosis.selection import LEVEL
from lieid_casadi.diagnosis.unexplained import Unexplained, smooth_bank, unexplained
from lieid_casadi.effects import Placement
from lieid_casadi.identification import Fit
from lieid_casadi.identification.identify import center_temperature, unique_warnings
from lieid_casadi.identification.noise_model import Noise
from lieid_casadi.recording import Recording, process

Array = NDArray[np.float64]
MISFIT = 1.15  # times the held-out error of the fit: more, and something has changed
WORTH = 0.1  # least fall of a joint's error that is worth a change
TINY = 1e-12  # of the largest variance: below it a number counts as that well known
MOST_CHANGES = 6
UNSEEN = 1e-6  # of a column's norm


def changed(
    fit: Fit,
    recordings: Sequence[Recording],
    *,
    seed: int,
    report: Callable[[str, float], None],
) -> Diagnosis:
    """Return what is no longer as the fit has it."""
    report("compare", 0.0)
    before = compare(fit, recordings)
    segments, _ = center_temperature(process(recordings, fit.processing), fit.temperature_mean)
    report("look for changes", 0.2)
    scene = Scene.of(fit, segments, kept=True)
    search = _Search(scene, held_out_noise(fit), seed)
    steps: list[Step] = []
    while len(steps) < MOST_CHANGES:
        step = search.next_step()
        if step is None:
            break
        steps.append(step)
        report("look for changes", 0.2 + 0.1 * len(steps))
    left = search.left_over()
    out = {p.label for p in search.stand_ins(left)}
    if out:
        steps = [step for step in steps if step.label not in out]
        left = search.without(out)
    left = described(left, Remainder.of(scene, search.plain, search.beside()))
    verdict = "unexplained" if left else "effect_found" if steps else "sufficient"
    report("done", 1.0)
    return Diagnosis(
        mode="changed",
        verdict=verdict,
        joint_names=before.joint_names,
        noise_floor=search.null,
        noise_source="held_out",
        baseline_effects=tuple(fit.model.effects),
        baseline_train=None,
        baseline_test=before.rms,
        steps=tuple(steps),
        unexplained=left,
        rejected=tuple(search.rejected),
        tried=len(scene.bank.candidates),
        fit=fit,
        warnings=unique_warnings(before.warnings),
        train=fit.provenance.recordings,
        test=before.recordings,
    )


class _Search:
    """Changes found so far, on rows of the new recordings."""

    def __init__(self, scene: Scene, noise: tuple[Noise, ...], seed: int) -> None:
        self.scene, self.noise, self.seed = scene, noise, seed
        self.null = np.array([each.spread for each in noise])
        self.plain = tuple(Noise.white(each.spread) for each in noise)
        self.bank = scene.bank.whitened(self.plain, scene.runs)
        self.baseline = _with_prior(scene, self.plain)
        self.kept = _kept(scene, self.plain)
        self.blocks = block_index(scene, self.plain, BLOCK)
        self.folds = block_index(scene, self.plain, FOLD) % FOLDS
        self.chosen: list[int] = []
        self.rejected: list[tuple[str, str]] = []

    def next_step(self) -> Step | None:
        """Return the next change, or None."""
        barred = np.zeros(len(self.bank.candidates), dtype=bool)
        out = {label for label, _ in self.rejected}
        for k, candidate in enumerate(self.bank.candidates):
            barred[k] = candidate.placement.label in out
        for g in self.chosen:
            barred[self.bank.candidate[g]] = True
        here = with_groups(self.baseline, self.bank, self.chosen)
        high = self._misfit(self.chosen) > MISFIT
        price = Price(each=float(np.log(max(here.rows, 2))), part=WORTH)
        found = best_set(self.bank, here, price, barred) if high.any() else []
        for winner in by_contribution(self.bank, here, found):
            others = [g for g in found if g != winner]
            step = self._tried(here, winner, others, high)
            if step is not None:
                return step
        return None

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
        if log10_p > np.log10(LEVEL):
            self.rejected.append((label, f"family-wise p = {10.0**log10_p:.2g}"))
            return None
        if held <= 0.0 or not fall[joint] >= WORTH:
            reason = f"error falls by {100 * fall[joint]:.1f} % only where it was raised"
            self.rejected.append((label, reason))
            return None
        self.chosen.append(winner)
        sizes = self.null * after
        return Step(
            label=label,
            effect=candidate.name,
            joints=candidate.joints,
            parameters=self._values(candidate, here, columns, winner),
            rms_train=None,
            rms_test=sizes,
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
        rest = here.padded(columns)
        rest = rest - here.basis @ (here.basis.T @ rest)
        size = np.linalg.norm(columns, axis=0)
        size[size == 0.0] = 1.0
        # directions that the motion does not show stay at zero
        values = np.linalg.lstsq(rest / size, here.residual, rcond=UNSEEN)[0] / size
        named = {
            c.name: float(v) for c, v in zip(candidate.effect.coefficients, values, strict=True)
        }
        shapes = candidate.grid[self.bank.point[group]][: len(candidate.effect.shapes)]
        return named | {
            s.name: float(v) for s, v in zip(candidate.effect.shapes, shapes, strict=True)
        }

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
        placements = [self.bank.candidates[self.bank.candidate[g]].placement for g in self.chosen]
        return stand_ins(
            self.kept, with_groups(self.kept, self.bank, self.chosen), left, placements
        )

    def without(self, out: Collection[str]) -> tuple[Unexplained, ...]:
        """Take changes back, and return what smooth functions explain then."""
        self.rejected += [(label, STOOD_IN) for label in out]
        self.chosen = [
            g
            for g in self.chosen
            if self.bank.candidates[self.bank.candidate[g]].placement.label not in out
        ]
        return self.left_over()

    def beside(self) -> Baseline:
        """Return the rows beside the model and all changes found so far."""
        return with_groups(self.baseline, self.bank, self.chosen)

    def left_over(self) -> tuple[Unexplained, ...]:
        """Return what smooth functions explain where the error is still raised."""
        here = self.beside()
        high = self._misfit(self.chosen) > MISFIT
        if not high.any():
            return ()
        smooth = smooth_bank(self.scene.signals, self.scene.runs)
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


def held_out_noise(fit: Fit) -> tuple[Noise, ...]:
    """Return the noise of each joint's residual, as large as on data that the fit has not seen.

    It must not be taken from the new recording: a slow change would pass for the noise's memory.
    """
    ratio = np.nan_to_num(fit.rms_cv / np.maximum(fit.noise, 1e-300), nan=1.0)
    return tuple(
        n.times(max(float(r), 1.0)) for n, r in zip(fit.residual_noise, ratio, strict=True)
    )


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
