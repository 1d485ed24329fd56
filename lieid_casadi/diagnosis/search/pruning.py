"""Accepted effects to remove: redundant ones, and ones that only partly explain the residual."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import product

import numpy as np
from numpy.typing import NDArray

from lieid_casadi.diagnosis.options import RANK_TOLERANCE
from lieid_casadi.diagnosis.residual.unexplained import Unexplained
from lieid_casadi.diagnosis.screening.baseline import Baseline
from lieid_casadi.diagnosis.screening.candidate_columns import CandidateColumns
from lieid_casadi.diagnosis.screening.context import ScreeningContext
from lieid_casadi.diagnosis.screening.cross_validation import cross_validated_gain
from lieid_casadi.diagnosis.screening.smooth_functions import SmoothFunction, smooth_columns
from lieid_casadi.diagnosis.search.parameter_checks import belongs_to
from lieid_casadi.diagnosis.search.search_problem import SearchProblem
from lieid_casadi.diagnosis.search.search_results import AcceptedEffect
from lieid_casadi.diagnosis.wording import join_words
from lieid_casadi.effects import Placement
from lieid_casadi.identification.uncertainty.noise_model import Noise

Array = NDArray[np.float64]


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
    factor = context.factor(noise)
    penalty = np.log(max(len(factor.torque), 2))
    inverse = np.linalg.pinv(factor.triangle, rcond=RANK_TOLERANCE)
    values, covariance = inverse @ (factor.basis.T @ factor.torque), inverse @ inverse.T
    lengths = [len(own) for own in context.torque]
    found = []
    for placement in placements:
        own = columns_of(context, placement)
        # leaving columns out costs βᵀ·C⁻¹·β, C their block of (XᵀX)⁻¹
        cost = float(values[own] @ np.linalg.lstsq(covariance[np.ix_(own, own)], values[own])[0])
        if cost < max(len(own) * penalty, part * lengths[placement.joint]):
            found.append((cost, placement))
    return [placement for _, placement in sorted(found, key=lambda pair: pair[0])]


def without_partial_effects(problem: SearchProblem) -> tuple[Unexplained, ...]:
    """Remove effects that only partly explain the residual, and return the unexplained parts.

    Of several on a joint the weakest is removed first, and the others are examined again.
    """
    while True:
        parts = problem.unexplained()
        partial = _partial_effects(problem, parts)
        if not partial:
            return parts
        for placement, reason in partial:
            problem.remove([placement], reason)


def _partial_effects(
    problem: SearchProblem, parts: Sequence[Unexplained]
) -> list[tuple[Placement, str]]:
    """Return the effect of each joint that least explains an unexplained part, and why.

    On a joint with a large unexplained part, the right effect explains as much with smooth
    functions of the part's signals as without them, also on held-out data; or it explains nearly
    all that these functions explain, with far fewer parameters, where they can imitate it. An
    effect that merely resembles the cause does neither, and naming it would be misleading. What an
    effect explains is the fall of the held-out error when it was added; it is compared with what
    smooth functions explain in addition to it, and in its place.
    """
    first, last = problem.error_baselines()
    doubtful = [u for u in parts if _is_doubtful(u, first, last, problem)]
    if not doubtful:
        return []
    options, context = problem.options, problem.context
    smooth = context.smooth.whitened(problem.white, context.runs)
    full, folds = problem.current_baseline(problem.white), context.folds(problem.white)
    least = dict.fromkeys([part.joint for part in doubtful], options.least_part_of_smooth)
    out: dict[int, tuple[Placement, str]] = {}
    for part, effect in product(doubtful, problem.accepted):
        placement = effect.candidate.placement
        if placement.joint != part.joint or placement.whole_arm:
            continue
        without = problem.baseline_without(placement)
        columns = smooth_columns(smooth, part.joint, part.depends_on)
        adds = gain_with_smooth(full, without, columns) >= options.least_gain_with_smooth
        if adds and _holds_with_smooth(effect, without.with_columns(columns), problem):
            continue
        in_addition = "nothing that held-out data confirm" if adds else "little"
        before, after = effect.errors[:, part.joint] ** 2
        own, rest = before - after, part.fraction * problem.accepted[-1].errors[1, part.joint] ** 2
        gain = without.fall(full)
        share = min(
            max(own, 0.0) / (max(own, 0.0) + rest),
            gain / _smooth_gain(part, smooth, without, folds),
        )
        if share < least[part.joint]:
            least[part.joint] = share
            out[part.joint] = (
                placement,
                f"explains only {100 * share:.0f} % of what smooth functions of "
                f"{join_words(part.depends_on)} explain, and {in_addition} in addition to them",
            )
    return list(out.values())


def _holds_with_smooth(
    effect: AcceptedEffect, with_smooth: Baseline, problem: SearchProblem
) -> bool:
    """Whether held-out data confirm an effect in addition to smooth functions.

    A column can follow what the smooth functions do not resolve in the few samples of one
    reversal, which no held-out part can judge.

    Parameters
    ----------
    effect : AcceptedEffect
    with_smooth : Baseline
        Of the model without the effect and with the smooth functions.
    problem : SearchProblem
    """
    placement = effect.candidate.placement
    held_out = problem.held_out_rows.errors(
        problem.columns_of(placement, problem.white),
        with_smooth,
        blocks=placement.effect.per_recording,
    )
    return held_out.is_confirmed


def _smooth_gain(
    part: Unexplained,
    smooth: CandidateColumns[SmoothFunction],
    without: Baseline,
    folds: NDArray[np.intp],
) -> float:
    """Return the largest held-out gain of a smooth function of a part's signals.

    Parameters
    ----------
    part : Unexplained
    smooth : CandidateColumns
        Whitened as the baseline is.
    without : Baseline
        Of the model without the effect that is examined.
    folds : (R,) int
    """
    gains = [
        cross_validated_gain(smooth.stacked(g), without, folds)
        for g, function in enumerate(smooth.owners)
        if function.joint == part.joint and function.is_function_of(part.depends_on)
    ]
    return max([*gains, 1e-300])


def gain_with_smooth(full: Baseline, without: Baseline, smooth: Array) -> float:
    """Return an effect's gain in addition to smooth functions, relative to its gain without them.

    Parameters
    ----------
    full, without : Baseline
        Of the model with the effect and without it.
    smooth : (R, k)
        Columns of smooth functions.
    """
    alone = without.fall(full)
    small, large = (b.with_columns(smooth) for b in (without, full))
    with_smooth = small.fall(large)
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
    return context.factor(noise).baseline(without=columns_of(context, placement))


def _is_doubtful(
    part: Unexplained, first: Baseline, last: Baseline, problem: SearchProblem
) -> bool:
    """Whether much is unexplained on a joint relative to what its effects explain."""
    rows = first.joint(part.joint)
    total, rest = (float(np.sum(b.residual[rows] ** 2)) for b in (first, last))
    explained = max(total - rest, 0.0)
    return part.fraction * rest > problem.options.doubtful_residual * explained


def columns_of(context: ScreeningContext, placement: Placement) -> list[int]:
    """Return the positions of an effect's columns and shape parameters among the model's."""
    model = context.fit.model
    every = (*model.base_columns, *model.shapes)
    return [k for k, p in enumerate(every) if belongs_to(placement, p.name, p.joint)]
