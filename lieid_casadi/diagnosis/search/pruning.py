"""Accepted effects to remove: redundant ones, and ones that only partly explain the residual."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import product

import numpy as np
from numpy.typing import NDArray

from lieid_casadi.diagnosis.residual.unexplained import Unexplained
from lieid_casadi.diagnosis.screening.baseline import Baseline
from lieid_casadi.diagnosis.screening.context import ScreeningContext
from lieid_casadi.diagnosis.screening.smooth_functions import smooth_columns
from lieid_casadi.diagnosis.search.parameter_checks import belongs_to
from lieid_casadi.diagnosis.search.search_problem import SearchProblem
from lieid_casadi.effects import Placement
from lieid_casadi.identification.uncertainty.noise_model import Noise

Array = NDArray[np.float64]
PARTIAL = "only partly explains the residual"


def redundant_effects(
    context: ScreeningContext,
    noise: Sequence[Noise],
    placements: Sequence[Placement],
    part: float,
) -> list[Placement]:
    """Return accepted effects without which the model fits as well, the weakest first.

    An effect is redundant if leaving it out costs less than the logarithm of the number of rows
    for each of its parameters (Schwarz), or less than a part of the rows of its joint.

    Parameters
    ----------
    context : ScreeningContext
        Of the last model.
    noise : sequence of Noise
        White noise of each joint.
    placements : sequence of Placement
        Effects of the model to examine.
    part : float
        0 to 1.
    """
    full = context.baseline(noise)
    before = float(np.sum(full.residual**2))
    found = []
    for placement in placements:
        smaller = baseline_without(context, noise, placement)
        cost = float(np.sum(smaller.residual**2)) - before
        rows = full.ends[placement.joint + 1] - full.ends[placement.joint]
        parameters = len(_columns_of(context, placement))
        if cost < max(parameters * np.log(max(full.rows, 2)), part * float(rows)):
            found.append((cost, placement))
    return [placement for _, placement in sorted(found, key=lambda pair: pair[0])]


def partial_effects(problem: SearchProblem, parts: Sequence[Unexplained]) -> list[Placement]:
    """Return accepted effects that only partly explain what the residual follows.

    On a joint with a large unexplained part, the right effect explains as much with smooth
    functions of the signals as without them. An effect that merely resembles the cause does not,
    and naming it would be misleading.
    """
    first, last = problem.error_baselines()
    doubtful = [u for u in parts if _is_doubtful(u, first, last, problem)]
    if not doubtful:
        return []
    smooth = problem.context.smooth.whitened(problem.white, problem.context.runs)
    full = problem.current_baseline(problem.white)
    out = []
    for part, effect in product(doubtful, problem.accepted):
        placement = effect.candidate.placement
        if placement.joint == part.joint and not placement.whole_arm:
            columns = smooth_columns(smooth, part.joint, part.depends_on)
            without = problem.baseline_without(placement)
            least = problem.options.least_gain_with_smooth
            if gain_with_smooth(full, without, columns) < least:
                out.append(placement)
    return out


def gain_with_smooth(full: Baseline, without: Baseline, smooth: Array) -> float:
    """Return an effect's gain in addition to smooth functions, relative to its gain without them.

    Parameters
    ----------
    full, without : Baseline
        Of the model with the effect and without it.
    smooth : (R, k)
        Columns of smooth functions.
    """
    alone = float(np.sum(without.residual**2) - np.sum(full.residual**2))
    small, large = (b.with_columns(smooth) for b in (without, full))
    with_smooth = float(np.sum(small.residual**2) - np.sum(large.residual**2))
    return with_smooth / alone if alone > 0.0 else 1.0


def baseline_without(
    context: ScreeningContext, noise: Sequence[Noise], placement: Placement
) -> Baseline:
    """Return the baseline of a model without the columns of one of its effects.

    Parameters
    ----------
    context : ScreeningContext
    noise : sequence of Noise
    placement : Placement
    """
    every = np.arange(context.model_columns[0].shape[1])
    return context.baseline(noise, np.setdiff1d(every, _columns_of(context, placement)))


def _is_doubtful(
    part: Unexplained, first: Baseline, last: Baseline, problem: SearchProblem
) -> bool:
    """Whether much is unexplained on a joint relative to what its effects explain."""
    rows = first.joint(part.joint)
    total, rest = (float(np.sum(b.residual[rows] ** 2)) for b in (first, last))
    explained = max(total - rest, 0.0)
    return part.fraction * rest > problem.options.doubtful_residual * explained


def _columns_of(context: ScreeningContext, placement: Placement) -> list[int]:
    """Return the positions of an effect's columns and shape parameters among the model's."""
    model = context.fit.model
    every = (*model.base_columns, *model.shapes)
    return [k for k, p in enumerate(every) if belongs_to(placement, p.name, p.joint)]
