"""Which effects are missing, one after another: chosen in training, confirmed by the test."""

from __future__ import annotations

import logging
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from lieid_casadi.diagnosis.bank import Bank
from lieid_casadi.diagnosis.candidates import Candidate
from lieid_casadi.diagnosis.evidence import Family
from lieid_casadi.diagnosis.forward import Price, best_set, column_stack, with_groups
from lieid_casadi.diagnosis.rivals import FOLDS, Rival, cross_validated_gain, rivals_of
from lieid_casadi.diagnosis.scene import Scene
from lieid_casadi.diagnosis.screening import Baseline, screen
from lieid_casadi.diagnosis.whitening import Noise, noise_of
from lieid_casadi.identification import Fit
from lieid_casadi.identification.fixed_point import ShapeStart
from lieid_casadi.identification.shape_range import ShapeRange
from lieid_casadi.model import Model
from lieid_casadi.recording import Processed

Array = NDArray[np.float64]
Refit = Callable[[Model, ShapeStart | None], Fit]
Judge = Callable[[Fit], Array]  # error on the test per joint (n,), NaN where there is none
logger = logging.getLogger("lieid_casadi")

PILOT = Price(each=5.0, part=0.02)
WORTH = 0.03  # least fall of a joint's held-out error that is worth an effect
LEVEL = 1e-3  # family-wise p-value above which an effect is noise
ZOOMS = 2  # rounds in which the grids of shape parameters are refined
STRONG = 0.25  # of the best gain: candidates whose grids are refined
MOST_STEPS = 12
BLOCK = 1.0  # s, of blocks whose residuals count as independent
FOLD = 2.0  # s, of blocks that go to the folds in turn


@dataclass(frozen=True, eq=False)
class Found:
    """One accepted effect.

    Attributes
    ----------
    candidate : Candidate
    fit : Fit
        After a joint refit with it.
    log10_p : float
        Family-wise, over everything that was tried.
    gain : float
        Fall of the whitened residual's sum of squares, in units of the noise's variance.
    cross_validated : (n,)
        Held-out error per joint before and after, N·m: (2, n).
    confirmed : bool or None
        Whether the test's error fell; None without a test.
    rivals : tuple of (Candidate, kind)
    """

    candidate: Candidate
    fit: Fit
    log10_p: float
    gain: float
    effective_rows: int
    cross_validated: Array
    confirmed: bool | None
    rivals: tuple[tuple[Candidate, str], ...]


@dataclass(frozen=True)
class Rejected:
    """A candidate that looked best and was not accepted, and why."""

    candidate: Candidate
    reason: str


@dataclass(frozen=True)
class Proposal:
    """A step that is about to be accepted; ``joint`` (from 0) is where the error falls most.

    ``before`` and ``after`` are held-out errors there, N·m.
    """

    label: str
    joint: int
    before: float
    after: float


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
        scene = Scene.of(self.fit, self.segments)
        self.noise, self.plain = pilot_noise(scene)
        for step in range(MOST_STEPS):
            report("look for what is missing", step / MOST_STEPS)
            if not self._add_one(scene):
                break
            scene = Scene.of(self.fit, self.segments, before=scene)
        return self._polished(scene)

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
            point = _refined_shapes(bank, screen(bank, beside).gain, winner)
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
            chosen = best_set(bank, baseline, _price(baseline), barred)
            peaks = [*chosen, *_peaks(bank, screen(bank, baseline).gain)] if chosen else []
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
        before, after = self.fit.rms_cv, fit.rms_cv
        fall = 1.0 - after / before
        if np.nanmax(fall) < WORTH:
            self._refuse(candidate, f"held-out error falls by {100 * np.nanmax(fall):.1f} % only")
            return False
        joint = int(np.nanargmax(fall))
        tested = self.judge(fit)[joint] < self.judge(self.fit)[joint]
        confirmed = None if np.isnan(self.judge(fit)[joint]) else bool(tested)
        if confirmed is False:
            self._refuse(candidate, "the test's error does not fall")
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

    def _polished(self, scene: Scene) -> Scene:
        """Fit all shape parameters together at the end; steps before had them from the grid."""
        if not self.found or not len(self.fit.shapes):
            return scene
        self.fit = self.refit(self.fit.model, ShapeStart(self.fit.shapes))
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


def pilot_noise(scene: Scene) -> tuple[tuple[Noise, ...], tuple[Noise, ...]]:
    """Estimate each joint's noise from what a generous first selection leaves.

    The fit's own residual holds what is missing as well; its memory would pass for the noise's.
    Returns the autoregressive noise, and white noise of the same size before whitening.
    """
    bank, baseline = scene.bank.whitened(scene.plain, scene.runs), scene.baseline(scene.plain)
    rich = with_groups(baseline, bank, best_set(bank, baseline, PILOT))
    freedom = 1.0 - rich.basis.shape[1] / max(rich.rows, 1)
    coloured, plain = [], []
    for j, (white, runs) in enumerate(zip(scene.plain, scene.runs, strict=True)):
        residual = rich.residual[rich.joint(j)] * white.sigma
        coloured.append(noise_of(residual, runs, freedom))
        size = np.sqrt(np.mean(residual**2) / max(freedom, 0.1)) if len(residual) else 1.0
        plain.append(Noise(np.ones(1), max(float(size), 1e-12)))
    return tuple(coloured), tuple(plain)


def _refined_shapes(bank: Bank[Candidate], gain: Array, winner: int) -> Array:
    """Return a group's shape parameters; a single one at the peak of a parabola of the gains."""
    candidate, point = bank.candidates[bank.candidate[winner]], int(bank.point[winner])
    shapes = candidate.grid[point, : len(candidate.effect.shapes)]
    if len(shapes) != 1 or not 0 < point < len(candidate.grid) - 1:
        return np.asarray(shapes)
    before, here, after = gain[winner - 1 : winner + 2]
    curvature = before - 2.0 * here + after
    if not 0.0 < max(before, after) <= here or curvature >= 0.0:
        return np.asarray(shapes)
    ranges = ShapeRange.of(candidate.effect.shapes)
    low, middle, high = ranges.place(candidate.grid[point - 1 : point + 2])[:, 0]
    shift = 0.5 * (before - after) / curvature
    return np.asarray(ranges.shapes(np.array([middle + shift * 0.5 * (high - low)])))


def _price(baseline: Baseline) -> Price:
    return Price(each=float(np.log(max(baseline.rows, 2))), part=WORTH)


def by_contribution(bank: Bank[Candidate], baseline: Baseline, chosen: Sequence[int]) -> list[int]:
    """Return the chosen groups, first that without which most is lost."""
    contribution = []
    for g in chosen:
        others = [h for h in chosen if h != g]
        contribution.append(screen(bank, with_groups(baseline, bank, others)).gain[g])
    return [chosen[k] for k in np.argsort(-np.array(contribution))] if chosen else []


def spokesman(
    bank: Bank[Candidate],
    beside: Baseline,
    winner: int,
    rivals: list[Rival],
    folds: NDArray[np.intp],
) -> tuple[int, list[Rival]]:
    """Return who speaks for a winner and its rivals, and the others.

    The fewest parameters, linear ones before shapes; among those the least error in blocked
    cross-validation.
    """
    gains = {
        g: cross_validated_gain(column_stack(bank, g), beside, folds)
        for g in [winner, *(r.group for r in rivals)]
    }
    tried = {g: bank.candidates[bank.candidate[g]] for g in gains}
    parameters = {g: (c.parameters, len(c.effect.shapes)) for g, c in tried.items()}
    best = min(gains, key=lambda g: (*parameters[g], -gains[g]))
    if best == winner:
        return winner, rivals
    kind = next(r.kind for r in rivals if r.group == best)
    rest = [r for r in rivals if r.group != best]
    return best, [Rival(winner, kind, gains[winner]), *rest]


def _peaks(bank: Bank[Candidate], gain: Array) -> list[int]:
    """Return the groups that explain much of what the best one does, peaks of each grid."""
    same = bank.candidate[1:] == bank.candidate[:-1]
    rises = np.append(same & (gain[1:] > gain[:-1]), False)
    falls = np.append(False, same & (gain[:-1] > gain[1:]))
    high = gain >= STRONG * gain.max(initial=0.0)
    return [int(g) for g in np.flatnonzero(high & ~rises & ~falls)]


def block_index(scene: Scene, noise: Sequence[Noise], length: float) -> NDArray[np.intp]:
    """Return the block of time of each row: blocks begin anew with each segment."""
    index, first = [], 0
    for segment in scene.segments:
        time = segment.filtered_time
        index.append(first + ((time - time[0]) / length).astype(np.intp))
        first = int(index[-1][-1]) + 1
    line = np.concatenate(index)
    return np.concatenate(
        [line[n.instants(runs)] for n, runs in zip(noise, scene.runs, strict=True)]
    )
