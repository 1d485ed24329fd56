"""Which candidate to try next: from the set that explains most to the one that speaks for it."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from lieid_casadi.diagnosis.screening.candidate_columns import Bank
from lieid_casadi.diagnosis.screening.candidates import Candidate
from lieid_casadi.diagnosis.screening.context import Scene
from lieid_casadi.diagnosis.screening.screen import Baseline, screen
from lieid_casadi.diagnosis.search.forward_selection import (
    Price,
    best_set,
    column_stack,
    with_groups,
)
from lieid_casadi.diagnosis.search.rivals import Rival, cross_validated_gain
from lieid_casadi.identification.regression.shape_range import ShapeRange
from lieid_casadi.identification.uncertainty.noise_model import Noise, noise_of

Array = NDArray[np.float64]
PILOT = Price(each=5.0, part=0.02)
SMOOTH = Price(each=5.0, part=0.3)  # what no effect is; less may be the noise's own memory
WORTH = 0.03  # least fall of a joint's held-out error that is worth an effect
BLOCK = 1.0  # s, of blocks whose residuals count as independent
FOLD = 2.0  # s, of blocks that go to the folds in turn
STRONG = 0.25  # of the best gain: candidates whose grids are refined


def pilot_noise(scene: Scene) -> tuple[tuple[Noise, ...], tuple[Noise, ...]]:
    """Estimate each joint's noise from what a generous first selection leaves.

    The fit's own residual holds what is missing as well; its memory would pass for the noise's.
    Returns the autoregressive noise, and white noise of the same size before whitening.
    """
    bank, baseline = scene.bank.whitened(scene.plain, scene.runs), scene.baseline(scene.plain)
    rich = with_groups(baseline, bank, best_set(bank, baseline, PILOT))
    smooth = scene.smooth.whitened(scene.plain, scene.runs)
    rich = with_groups(rich, smooth, best_set(smooth, rich, SMOOTH))
    freedom = 1.0 - rich.basis.shape[1] / max(rich.rows, 1)
    coloured = tuple(
        noise_of(
            rich.residual[rich.joint(j)] * white.sigma / runs.weights(white.spread), runs, freedom
        )
        for j, (white, runs) in enumerate(zip(scene.plain, scene.runs, strict=True))
    )
    return coloured, tuple(Noise.white(noise.spread) for noise in coloured)


def refined_shapes(bank: Bank[Candidate], gain: Array, winner: int) -> Array:
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


def price_of(baseline: Baseline) -> Price:
    """Return what an effect must bring: Schwarz's price per number, and the least part."""
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


def peaks_of(bank: Bank[Candidate], gain: Array) -> list[int]:
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
