"""The explainable part of the residual, and which signals it depends on.

Smooth functions of each signal, and of pairs of signals, are screened like candidates. Their
gains are those on held-out blocks of time.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from lieid_casadi.diagnosis.options import DiagnosisOptions
from lieid_casadi.diagnosis.screening.baseline import Baseline
from lieid_casadi.diagnosis.screening.candidate_columns import CandidateColumns
from lieid_casadi.diagnosis.screening.cross_validation import cross_validated_gain
from lieid_casadi.diagnosis.screening.evidence import HypothesisFamily
from lieid_casadi.diagnosis.screening.screen import screen
from lieid_casadi.diagnosis.screening.smooth_functions import SmoothFunction

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from lieid_casadi.diagnosis.residual.shapes import SmoothShape
    from lieid_casadi.diagnosis.residual.symbolic_formula import Formula

SHORTLIST = 6  # groups whose held-out gain is computed, those with the largest gain


@dataclass(frozen=True)
class Unexplained:
    """An explainable part of one joint's residual.

    Attributes
    ----------
    joint : int
        From 0.
    fraction : float
        Of the variance of the joint's residual, on held-out blocks of time.
    depends_on : tuple of str
        At most three signals, those that explain most first.
    terms : tuple of tuple of str
        Signals of each smooth function, the one that explains most first.
    shapes : tuple of SmoothShape
        These functions, with confidence bands.
    formula : Formula or None
        A short formula that explains nearly as much.
    """

    joint: int
    fraction: float
    depends_on: tuple[str, ...]
    terms: tuple[tuple[str, ...], ...] = ()
    shapes: tuple[SmoothShape, ...] = field(default=(), repr=False)
    formula: Formula | None = field(default=None, repr=False)

    def to_dict(self) -> dict[str, Any]:
        """Return it for JSON, joints from 1."""
        return {
            "joint": self.joint + 1,
            "fraction": self.fraction,
            "depends_on": list(self.depends_on),
            "form": None if self.formula is None else self.formula.to_dict(),
            "shape": [shape.to_dict() for shape in self.shapes],
        }

    def as_effect_code(self) -> str:
        """Return Python code that registers it as a user-defined effect with free coefficients.

        See `own_effects` for the labels under which the effects are added to a model.
        """
        from lieid_casadi.diagnosis.residual.user_effect_code import own_effects

        return own_effects([self]).code

    def plot(self, ax: Axes | None = None) -> Figure:
        """Draw the first smooth function as a curve with its band or as a map; not shown."""
        from lieid_casadi.diagnosis.residual.shape_plots import plot_shapes

        return plot_shapes([self], ax)


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


def find_unexplained(
    plain: SmoothScreen,
    coloured: SmoothScreen,
    folds: NDArray[np.intp],
    *,
    options: DiagnosisOptions,
    seed: int,
) -> tuple[Unexplained, ...]:
    """Return the joints whose residual depends on signals, those with the largest gain first.

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
    screening = screen(coloured.functions, coloured.baseline, options)
    if not len(screening.gain):
        return ()
    family = HypothesisFamily.of(screening, seed=seed, draws=options.bootstrap_draws)
    found = []
    for joint in range(len(plain.baseline.ends) - 1):
        own = [g for g, c in enumerate(plain.functions.owners) if c.joint == joint]
        variance = float(np.sum(plain.baseline.residual[plain.baseline.joint(joint)] ** 2))
        spread = np.mean(coloured.baseline.residual[coloured.baseline.joint(joint)] ** 2)
        significant = [
            g
            for g in own
            if family.log10_p(screening.gain[g] / max(spread, 1.0), int(screening.rank[g]))
            < np.log10(options.residual_significance)
        ]
        names, terms, gain = _strongest(plain, significant, folds, variance, options)
        fraction = gain / variance if variance > 0.0 else 0.0
        if names and fraction >= _least_part(names, options):
            part = Unexplained(joint, min(fraction, 1.0), names, terms)
            found.append((fraction * variance, part))
    return tuple(u for _, u in sorted(found, key=lambda pair: -pair[0]))


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
) -> tuple[tuple[str, ...], tuple[tuple[str, ...], ...], float]:
    """Add the group with the largest held-out gain until a further one adds little.

    Returns
    -------
    signals : tuple of str
    terms : tuple of tuple of str
    gain : float
        Held-out gain of all that was added.
    """
    functions, baseline = plain.functions, plain.baseline
    names: list[str] = []
    terms: list[tuple[str, ...]] = []
    total = 0.0
    while len(names) < options.most_signals:
        gain = screen(functions, baseline, options).gain
        best = sorted(groups, key=lambda g: -gain[g])[:SHORTLIST]
        gains = [cross_validated_gain(functions.stacked(g), baseline, folds) for g in best]
        least = max(
            0.5 * options.least_residual_part * variance, options.least_further_part * total
        )
        if not gains or max(gains) < least:
            break
        winner = best[int(np.argmax(gains))]
        signals = functions.owner(winner).signals
        fresh = [s for s in signals if s not in names]
        names += fresh[: options.most_signals - len(names)]
        terms.append(signals)
        total += max(gains)
        baseline = baseline.with_columns(functions.stacked(winner))
        groups = [g for g in groups if g != winner]
    return tuple(names), tuple(terms), total
