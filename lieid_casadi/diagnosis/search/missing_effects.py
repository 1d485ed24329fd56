"""Which effects are missing, one after another: chosen in training, confirmed by the test."""

from __future__ import annotations

import logging
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from lieid_casadi.diagnosis.screening.candidates import Candidate
from lieid_casadi.diagnosis.screening.context import Scene
from lieid_casadi.diagnosis.screening.screen import screen
from lieid_casadi.diagnosis.search.candidate_selection import (
    BLOCK,
    FOLD,
    WORTH,
    block_index,
    by_contribution,
    peaks_of,
    pilot_noise,
    price_of,
    refined_shapes,
    spokesman,
)
from lieid_casadi.diagnosis.search.evidence import Family
from lieid_casadi.diagnosis.search.forward_selection import best_set, column_stack, with_groups
from lieid_casadi.diagnosis.search.parameter_checks import beyond_motion, out_of_bounds
from lieid_casadi.diagnosis.search.pruning import superfluous
from lieid_casadi.diagnosis.search.rivals import FOLDS, rivals_of
from lieid_casadi.diagnosis.search.search_results import Found, Proposal, Rejected
from lieid_casadi.effects import Placement
from lieid_casadi.identification import Fit
from lieid_casadi.identification.regression.fixed_point import ShapeStart
from lieid_casadi.model import Model
from lieid_casadi.recording import Processed

Array = NDArray[np.float64]
Refit = Callable[[Model, ShapeStart | None], Fit]
Judge = Callable[[Fit], Array]  # error on the test per joint (n,), NaN where there is none
logger = logging.getLogger("lieid_casadi")

LEVEL = 1e-3  # family-wise p-value above which an effect is noise
ZOOMS = 2  # rounds in which the grids of shape parameters are refined
MOST_STEPS = 12
ON_ALL = 0.02  # the least fall of all joints' mean square error that is worth an arm's effect


@dataclass
class Search:
    """The search's state: the fit so far, what was accepted and what was turned down."""

    fit: Fit
    segments: tuple[Processed, ...]
    refit: Refit
    judge: Judge
    seed: int = 0
    ask: Callable[[Proposal], bool] | None = None
    found: list[Found] = field(default_factory=list)
    rejected: list[Rejected] = field(default_factory=list)

    def run(self, report: Callable[[str, float], None]) -> Scene:
        """Add effects until nothing is worth one more; return the last scene."""
        scene = self.first = Scene.of(self.fit, self.segments)
        self.noise, self.plain = pilot_noise(scene)
        for step in range(MOST_STEPS):
            report("look for what is missing", step / MOST_STEPS)
            if not self._add_one(scene):
                break
            scene = Scene.of(self.fit, self.segments, before=scene)
            out = superfluous(scene, self.plain, self._accepted[:-1], WORTH)
            if out:
                scene = self.without(out[:1], "made superfluous by a later effect", scene)
        return self._polished(scene)

    @property
    def _accepted(self) -> list[Placement]:
        return [found.candidate.placement for found in self.found]

    def without(self, out: Sequence[Placement], reason: str, scene: Scene) -> Scene:
        """Take accepted effects out again, fit the rest anew, and return the scene."""
        labels = {placement.label for placement in out}
        self.rejected += [
            Rejected(f.candidate, reason)
            for f in self.found
            if f.candidate.placement.label in labels
        ]
        self.found = [f for f in self.found if f.candidate.placement.label not in labels]
        model, shapes = self.first.fit.model, dict(_shape_values(self.fit))
        self.fit = self.first.fit
        for k, found in enumerate(self.found):
            placements = (*model.placements, found.candidate.placement)
            model = Model.of_placements(model.robot, placements)
            held = np.array([shapes[p.label] for p in model.shapes])
            self.fit = self.refit(model, ShapeStart(held, held=True))
            self.found[k] = replace(found, fit=self.fit)
        return Scene.of(self.fit, self.segments, before=scene)

    def _add_one(self, scene: Scene) -> bool:
        scene, chosen = self._chosen(scene)
        bank, baseline = scene.bank.whitened(self.plain, scene.runs), scene.baseline(self.plain)
        blocks = block_index(scene, self.plain, BLOCK)
        folds = block_index(scene, self.plain, FOLD) % FOLDS
        for winner in by_contribution(bank, baseline, chosen):
            others = [g for g in chosen if g != winner]
            rivals = rivals_of(bank, baseline, others, winner, blocks)
            beside = with_groups(baseline, bank, others)
            winner, rivals = spokesman(bank, beside, winner, rivals, folds)
            candidate = bank.candidates[bank.candidate[winner]]
            named = [(bank.candidates[bank.candidate[r.group]], r.kind) for r in rivals]
            point = refined_shapes(bank, screen(bank, beside).gain, winner)
            if self._try(scene, candidate, point, winner, others, named):
                return True
        return False

    def _chosen(self, scene: Scene) -> tuple[Scene, list[int]]:
        """Return the groups that together explain most, on grids refined where it matters."""
        refused = {r.candidate.placement.label for r in self.rejected}
        zoomed: set[str] = set()
        baseline = scene.baseline(self.plain)
        for _ in range(ZOOMS + 1):
            bank = scene.bank.whitened(self.plain, scene.runs)
            barred = np.array([c.placement.label in refused for c in bank.candidates], dtype=bool)
            chosen = best_set(bank, baseline, price_of(baseline), barred)
            peaks = [*chosen, *peaks_of(bank, screen(bank, baseline).gain)] if chosen else []
            points: dict[int, list[int]] = {}
            for g in peaks:
                candidate = bank.candidates[bank.candidate[g]]
                if candidate.effect.shapes and candidate.placement.label not in zoomed:
                    points.setdefault(int(bank.candidate[g]), []).append(int(bank.point[g]))
            if not points:
                break
            zoomed |= {bank.candidates[k].placement.label for k in points}
            scene = scene.zoomed(points)
        return scene, chosen

    def _try(
        self,
        scene: Scene,
        candidate: Candidate,
        point: Array,
        winner: int,
        others: Sequence[int],
        rivals: Sequence[tuple[Candidate, str]],
    ) -> bool:
        """Accept a candidate if it is no noise, worth its parameters, and the test agrees."""
        log10_p, gain, rows = self._evidence(scene, winner, others)
        label = candidate.placement.label
        if log10_p > np.log10(LEVEL):
            self._refuse(candidate, f"family-wise p = {10.0**log10_p:.2g}")
            return False
        placements = (*self.fit.model.placements, candidate.placement)
        wanted = Model.of_placements(self.fit.model.robot, placements)
        start = np.concatenate([self.fit.shapes, point])
        fit = self.refit(wanted, ShapeStart(start, held=True))
        against = out_of_bounds(fit, candidate.placement)
        if against:
            self._refuse(candidate, against)
            return False
        before, after = self.fit.rms_cv, fit.rms_cv
        fall = 1.0 - after / before
        if np.nanmax(fall) < WORTH:
            self._refuse(candidate, f"held-out error falls by {100 * np.nanmax(fall):.1f} % only")
            return False
        joint = int(np.nanargmax(fall))
        on_all = 1.0 - self._all_joints(after) / self._all_joints(before)
        if candidate.reaches_all and on_all < ON_ALL:
            self._refuse(candidate, f"error of all joints falls by {100 * on_all:.1f} % only")
            return False
        confirmed = self._confirmed(fit, joint)
        if confirmed is False:
            self._refuse(candidate, "the test's error does not fall")
            return False
        if self._within_a_sample(candidate, fit):
            self._refuse(
                candidate, "a delay below one sample: deriving the velocity shifts as much"
            )
            return False
        proposal = Proposal(label, joint, float(before[joint]), float(after[joint]))
        if self.ask is not None and not self.ask(proposal):
            self._refuse(candidate, "not wanted")
            return False
        logger.info("accepted %s: p = 1e%.0f, fall %.1f %%", label, log10_p, 100 * fall[joint])
        self.found.append(
            Found(
                candidate,
                fit,
                log10_p,
                gain,
                rows,
                np.array([before, after]),
                confirmed,
                tuple(rivals),
            )
        )
        self.fit = fit
        return True

    def _all_joints(self, errors: Array) -> float:
        """Return the mean square of errors (n,) over the joints' noise."""
        return float(
            np.nanmean([(e / n.spread) ** 2 for e, n in zip(errors, self.plain, strict=True)])
        )

    def _confirmed(self, fit: Fit, joint: int) -> bool | None:
        """Whether the test's error falls on a joint, and no more rises on others."""
        before, after = self.judge(self.fit), self.judge(fit)
        if np.isnan(after[joint]):
            return None
        falls = after[joint] < before[joint]
        return bool(falls and self._all_joints(after) < self._all_joints(before))

    def _within_a_sample(self, candidate: Candidate, fit: Fit) -> bool:
        """Whether a delay is shorter than the recordings can tell from a shifted velocity."""
        if candidate.name != "torque_delay":
            return False
        labels = [column.label for column in fit.model.columns]
        delay = fit.effect_coefficients[
            labels.index(f"torque_delay.delta:{candidate.joints[0] + 1}")
        ]
        slowest = min(segment.recording.rate for segment in self.segments)
        return bool(abs(delay) * slowest < 1.0)

    def _polished(self, scene: Scene) -> Scene:
        """Fit all shape parameters together at the end; steps before had them from the grid."""
        if not self.found or not len(self.fit.shapes):
            return scene
        polished = self.refit(self.fit.model, ShapeStart(self.fit.shapes))
        for placement in self._accepted:
            against = out_of_bounds(polished, placement) or beyond_motion(
                polished, placement, self.segments
            )
            if against:
                return self._polished(self.without([placement], against, scene))
        self.fit = polished
        self.found[-1] = replace(self.found[-1], fit=self.fit)
        return Scene.of(self.fit, self.segments, before=scene)

    def _refuse(self, candidate: Candidate, reason: str) -> None:
        logger.info("refused %s: %s", candidate.placement.label, reason)
        self.rejected.append(Rejected(candidate, reason))

    def _evidence(
        self, scene: Scene, winner: int, others: Sequence[int]
    ) -> tuple[float, float, int]:
        """Return log₁₀ of the family-wise p-value, the whitened gain and how many rows."""
        bank = scene.bank.whitened(self.noise, scene.runs)
        beside = with_groups(scene.baseline(self.noise), bank, others)
        screening = screen(bank, beside, every=True)
        after = beside.with_columns(column_stack(bank, winner))
        freedom = max(after.rows - after.basis.shape[1], 1)
        dispersion = max(float(np.sum(after.residual**2)) / freedom, 1.0)
        gain = float(screening.gain[winner]) / dispersion
        family = Family.of(screening, seed=self.seed, further=scene.scanned)
        return family.log10_p(gain, int(screening.rank[winner])), gain, after.rows


def _shape_values(fit: Fit) -> list[tuple[str, float]]:
    return [(p.label, float(x)) for p, x in zip(fit.model.shapes, fit.shapes, strict=True)]
