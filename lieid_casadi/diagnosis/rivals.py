"""Effects that would do as well as one that was found, in its place."""

from __future__ import annotations

from collections.abc import Sequence
from functools import reduce

import numpy as np

from lieid_casadi.arrays import Array, Indices
from lieid_casadi.diagnosis.candidates import Candidate, follows_temperature, reason_against
from lieid_casadi.diagnosis.evidence import ALIKE, Slot, part_of, solved
from lieid_casadi.diagnosis.path import PathState
from lieid_casadi.diagnosis.search import SMOOTH, Round
from lieid_casadi.diagnosis.smooth_functions import own_signals
from lieid_casadi.diagnosis.step import Rival
from lieid_casadi.effects.smooth import Smooth

EXACT = 1e-6  # part of a torque by which exact rivals differ
LEAST_GAIN = 0.5  # of an effect's gain in its place
EXAMINED = 8  # candidates with the largest gains that can replace most of the effect's torque
BLOCK = 1.0  # s, at least, of blocks whose errors are compared


def rivals_of(
    found: Round, slot: Slot, others: Sequence[int], deviations: float
) -> list[tuple[int, Rival]]:
    """Return the groups that the data do not separate from an effect, nearest first, as rivals.

    The errors of the two models, both with the groups ``others``, are compared over blocks of time
    (Vuong, Econometrica 1989), each with the cost of its parameters. Candidates that stand in the
    effect's place in a path without a held-out part are compared, too; with friction that changes
    with time, changes at one instant. ``deviations`` are the standard errors by which the effect
    must be better. A smooth function, which is no hypothesis, is a rival of an effect of the
    library if a path would choose it in its place.
    """
    paths, columns = found.paths, found.paths.columns
    gains, values = reduce(PathState.with_group, others, paths.state(-1)).gains(free=True)
    net = gains - found.penalty
    candidate = columns.candidate(slot.group)
    torque = paths.outside(slot.group) @ slot.values
    examined = _examined(found, gains, values, slot, torque)
    beside = [paths.outside(g) for g in others]
    block = _blocks(found)
    mine = _squares(found, [*beside, paths.outside(slot.group)], block)
    rivals = []
    for group in examined:
        rival = columns.candidate(group)
        if rival.name == SMOOTH != candidate.name:
            worse, error = float(net[slot.group] - net[group]) / len(mine), 0.0
        else:
            theirs = _squares(found, [*beside, paths.outside(group)], block)
            worse, error = _difference(found, mine, theirs, rival.parameters - candidate.parameters)
        if worse > deviations * error:
            continue
        part = part_of(torque, paths.outside(group))
        kind = "exact" if part > 1.0 - EXACT**2 else "data"
        rivals.append((worse, int(group), Rival(rival.label, rival.name, rival.joints, kind)))
    return [(group, rival) for _, group, rival in sorted(rivals, key=lambda each: each[0])]


def _examined(found: Round, gains: Array, values: Array, slot: Slot, torque: Array) -> list[int]:
    """Return the best group of each candidate that can replace most of an effect's torque."""
    columns, rows = found.paths.columns, found.rows
    mine = columns.candidate(slot.group)
    fine = gains > LEAST_GAIN * gains[slot.group]
    near = np.flatnonzero(fine & columns.reach[columns.reach[:, slot.group]].any(axis=0))
    examined, done = list[int](), set[int]()
    for group in map(int, (*slot.instead, *near[np.argsort(-gains[near])])):
        other, owner = columns.candidate(group), int(columns.owner[group])
        sudden = other.course is not None and follows_temperature(mine.effect)
        if owner in done or not (other.of_arm or sudden) or _same_kind(mine, other):
            continue
        estimate = values[columns.of_group(group)]
        if reason_against(other, columns.shapes(group), estimate, rows.segments) is not None:
            continue  # another point of its grid may be plausible
        done.add(owner)
        if part_of(torque, found.paths.outside(group)) >= ALIKE:
            examined.append(group)
            if len(examined) == EXAMINED:
                break
    return examined


def _same_kind(mine: Candidate, other: Candidate) -> bool:
    """Whether two candidates are variants of one effect, or a smooth function of other signals.

    Smooth functions of the signals of an effect, which may contain it, are rivals: where one is
    better the form of the torque is not known. Smooth functions are rivals of each other.
    """
    if mine.name == other.name and mine.joints == other.joints:
        return mine.name != SMOOTH or mine.label == other.label
    if mine.name == SMOOTH or not isinstance(other.effect, Smooth):
        return False
    own = {(signal, mine.placement.source) for signal in own_signals(mine.effect)}
    return not (own and own <= set(other.effect.parts))


def _blocks(found: Round) -> Indices:
    """Return the block of time of each row (R + k,); those of a prior are one block."""
    length = max(BLOCK, 2.0 * found.folds.gap)
    times = np.concatenate([found.rows.times[run.all] for run in found.rows.runs])
    block = np.unique((times // length).astype(int), return_inverse=True)[1]
    return np.append(block, np.full(found.paths.span.of_prior, block.max() + 1))


def _squares(found: Round, columns: Sequence[Array], block: Indices) -> Array:
    """Return the sum of squared errors of each block of the model with further columns."""
    residual = found.paths.span.residual
    more = np.hstack(list(columns))
    error = residual - more @ solved(more.T @ more, more.T @ residual)
    return np.asarray(np.bincount(block, weights=error**2), dtype=float)


def _difference(found: Round, mine: Array, theirs: Array, parameters: int) -> tuple[float, float]:
    """Return by how much another model's squares are larger, with its standard error.

    Each of the ``parameters`` that it has more costs the logarithm of the rows.
    """
    worse = theirs - mine + parameters * np.log(len(found.paths.span.residual)) / len(mine)
    error = float(np.std(worse, ddof=1)) / np.sqrt(len(worse))
    return float(np.mean(worse)), max(error, 1e-12)
