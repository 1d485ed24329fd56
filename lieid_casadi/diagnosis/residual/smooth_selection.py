"""Search for the part of the residual that smooth functions of the signals explain.

Smooth functions of each signal, and of pairs of signals, are screened like candidates. Their
gains are those on held-out blocks of time.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from lieid_casadi.diagnosis.options import DiagnosisOptions
from lieid_casadi.diagnosis.residual.unexplained import Unexplained
from lieid_casadi.diagnosis.screening.baseline import Baseline, with_groups
from lieid_casadi.diagnosis.screening.candidate_columns import CandidateColumns
from lieid_casadi.diagnosis.screening.cross_validation import gains_of_folds
from lieid_casadi.diagnosis.screening.evidence import HypothesisFamily
from lieid_casadi.diagnosis.screening.screen import Screening, screen
from lieid_casadi.diagnosis.screening.smooth_functions import SmoothFunction, measured_signal

Array = NDArray[np.float64]
#: Functions of one signal, and of two, whose held-out gain is computed: the largest gains.
SHORTLIST = 5


@dataclass(frozen=True, eq=False)
class SmoothScreen:
    """Smooth functions and a baseline, whitened in the same way.

    Attributes
    ----------
    functions : CandidateColumns
    baseline : Baseline
    """

    functions: CandidateColumns[SmoothFunction]
    baseline: Baseline

    def with_functions(self, groups: Sequence[int]) -> SmoothScreen:
        """Return the screen with groups of its functions added to the baseline."""
        return replace(self, baseline=with_groups(self.baseline, self.functions, groups))


@dataclass(frozen=True, eq=False)
class _Found:
    """An unexplained part, its held-out gain, and the groups of its smooth functions."""

    part: Unexplained
    gain: float
    groups: tuple[int, ...]


def find_unexplained(
    plain: SmoothScreen,
    coloured: SmoothScreen,
    folds: NDArray[np.intp],
    *,
    options: DiagnosisOptions,
    seed: int,
) -> tuple[Unexplained, ...]:
    """Return the joints whose residual depends on signals, those with the largest gain first.

    The functions found on one joint are added to the model before the other joints are examined:
    a torque that the model lacks on one joint disturbs the parameters that all joints share.

    Parameters
    ----------
    plain : SmoothScreen
        On rows divided by the noise's standard deviation, where fractions of the variance are
        measured.
    coloured : SmoothScreen
        On rows whitened by the autoregressive noise, for the p-values.
    folds : (R,) int
        Fold of each plain row.
    options : DiagnosisOptions
    seed : int
        Of the bootstrap.
    """
    # no support is required of rows whitened by coloured noise, where steps become single rows
    screening = screen(coloured.functions, coloured.baseline, None)
    if not len(screening.gain):
        return ()
    family = HypothesisFamily.of(screening, seed=seed, draws=options.bootstrap_draws)
    joints = set(range(len(plain.baseline.ends) - 1))
    parts: list[Unexplained] = []
    while joints:
        significant = _significant(coloured, screening, family, options)
        each = [_of_joint(j, plain, significant[j], folds, options) for j in joints]
        found = [one for one in each if one is not None]
        if not found:
            break
        best = max(found, key=lambda one: one.gain)
        parts.append(best.part)
        joints.remove(best.part.joint)
        plain, coloured = (s.with_functions(best.groups) for s in (plain, coloured))
        screening = screen(coloured.functions, coloured.baseline, None)
    return tuple(parts)


def _significant(
    coloured: SmoothScreen,
    screening: Screening,
    family: HypothesisFamily,
    options: DiagnosisOptions,
) -> list[list[int]]:
    """Return, for each joint, the groups whose gain is significant.

    Parameters
    ----------
    coloured : SmoothScreen
    screening : Screening
        Of its functions.
    family : HypothesisFamily
    options : DiagnosisOptions
    """
    baseline = coloured.baseline
    found: list[list[int]] = [[] for _ in range(len(baseline.ends) - 1)]
    spread = [np.mean(baseline.residual[baseline.joint(j)] ** 2) for j in range(len(found))]
    for g, function in enumerate(coloured.functions.owners):
        gain = screening.gain[g] / max(spread[function.joint], 1.0)
        if family.log10_p(gain, int(screening.rank[g])) < np.log10(options.residual_significance):
            found[function.joint].append(g)
    return found


def _of_joint(
    joint: int,
    plain: SmoothScreen,
    significant: Sequence[int],
    folds: NDArray[np.intp],
    options: DiagnosisOptions,
) -> _Found | None:
    """Return the unexplained part of a joint, None if it is too small.

    Parameters
    ----------
    joint : int
        From 0.
    plain : SmoothScreen
    significant : sequence of int
        Groups of the joint.
    folds : (R,) int
    options : DiagnosisOptions
    """
    variance = float(np.sum(plain.baseline.residual[plain.baseline.joint(joint)] ** 2))
    groups, gain = _strongest(plain, significant, folds, variance, options)
    terms = tuple(plain.functions.owner(g).signals for g in groups)
    every = [measured_signal(name) for term in terms for name in term]
    names = tuple(dict.fromkeys(every))[: options.most_signals]
    fraction = gain / variance if variance > 0.0 else 0.0
    if not names or fraction < _least_part(names, options):
        return None
    return _Found(Unexplained(joint, min(fraction, 1.0), names, terms), gain, groups)


def _least_part(names: Sequence[str], options: DiagnosisOptions) -> float:
    if names[0] == "t":
        return options.least_residual_part_of_time
    return options.least_residual_part


def _strongest(
    plain: SmoothScreen,
    groups: Sequence[int],
    folds: NDArray[np.intp],
    variance: float,
    options: DiagnosisOptions,
) -> tuple[tuple[int, ...], float]:
    """Add the group with the largest held-out gain until a further one adds little.

    Parameters
    ----------
    plain : SmoothScreen
    groups : sequence of int
        To select from.
    folds : (R,) int
    variance : float
        Sum of squares of the joint's residual.
    options : DiagnosisOptions

    Returns
    -------
    selected : tuple of int
    gain : float
        Held-out gain of all that was added.
    """
    functions, baseline = plain.functions, plain.baseline
    tried = sorted(groups)
    of_tried = functions.of_owners(functions.owner_index[tried])  # one group each
    selected: list[int] = []
    names: set[str] = set()
    total = 0.0
    while groups and len(names) < options.most_signals:
        gain = dict(zip(tried, screen(of_tried, baseline, options).gain, strict=True))
        ordered = sorted(groups, key=lambda g: -gain[g])
        best = [
            g
            for count in (1, 2)
            for g in [g for g in ordered if len(functions.owner(g).signals) == count][:SHORTLIST]
        ]
        each = [gains_of_folds(functions.stacked(g), baseline, folds) for g in best]
        gains = [float(own.sum()) for own in each]
        least = max(
            0.5 * options.least_residual_part * variance, options.least_further_part * total
        )
        if not gains or max(gains) < least:
            break
        winner = preferred([functions.owner(g).signals for g in best], np.array(each), options)
        selected.append(best[winner])
        names |= {measured_signal(name) for name in functions.owner(best[winner]).signals}
        total += gains[winner]
        baseline = baseline.with_columns(functions.stacked(best[winner]))
        groups = [g for g in groups if g != best[winner]]
    return tuple(selected), total


def preferred(signals: Sequence[tuple[str, ...]], gains: Array, options: DiagnosisOptions) -> int:
    """Return the position of the simplest function that explains as much as any.

    Of those whose held-out gain is within one standard error of the largest (Breiman et al.,
    Classification and Regression Trees, 1984) it has the fewest signals. A function of time must
    be clearly the best: along one recording, time can stand for any signal of a motion that does
    not repeat.

    Parameters
    ----------
    signals : sequence of tuple of str
        Of each of G functions.
    gains : (G, F)
        Of each function on each fold.
    options : DiagnosisOptions
    """
    values = gains.sum(axis=1)
    of_time = np.array(["t" in names for names in signals])
    others = np.where(of_time, -np.inf, values)
    if others.max() >= options.least_part_of_time * values.max():
        values = others
    best = int(np.argmax(values))
    less = gains[best] - gains
    error = np.sqrt(gains.shape[1]) * less.std(axis=1, ddof=1)
    alike = np.isfinite(values) & (less.sum(axis=1) <= error)
    return min(map(int, np.flatnonzero(alike)), key=lambda g: (len(signals[g]), -values[g]))
