"""What remains of the error after all that was found, and which signals it follows.

Smooth functions of each signal, and of pairs with one signal of the joint itself, are screened
as candidates are. What counts is what they explain of held-out blocks.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from lieid_casadi.diagnosis.screening.candidate_columns import Bank, assemble
from lieid_casadi.diagnosis.screening.effect_columns import SegmentSignals
from lieid_casadi.diagnosis.screening.screen import Baseline, screen
from lieid_casadi.diagnosis.search.evidence import Family
from lieid_casadi.diagnosis.search.forward_selection import column_stack
from lieid_casadi.diagnosis.search.rivals import cross_validated_gain
from lieid_casadi.identification.uncertainty.noise_model import Runs

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from lieid_casadi.diagnosis.residual.shapes import SmoothShape
    from lieid_casadi.diagnosis.residual.symbolic_formula import Form

Array = NDArray[np.float64]
Ranges = dict[str, Array]  # of each signal: lowest and highest values (2, n)
LEVEL = 1e-4  # family-wise
LEAST = 0.08  # part of a joint's residual variance below which nothing is told
LEAST_SLOW = 0.3  # the same for functions of time: coloured noise drifts
ADDS = 0.25  # of what the signals before it explain: less, and a signal is not named
MOST_SIGNALS = 3
SLOW = 12  # half waves over a recording, up to which a function of time is smooth


@dataclass(frozen=True)
class Smooth:
    """A smooth function of one or two signals on one joint.

    ``signals`` are columns as in recordings: ``q3``, ``dq1``, ``temp2``, ``t``; ``load3`` is the
    model's rigid torque.
    """

    joint: int
    signals: tuple[str, ...]
    parameters: int

    @property
    def lower(self) -> tuple[float, ...]:
        """No bounds."""
        return (-np.inf,) * self.parameters


@dataclass(frozen=True)
class Unexplained:
    """An explainable part of one joint's residual.

    Attributes
    ----------
    joint : int
        From 0.
    fraction : float
        Of the residual's variance on held-out blocks.
    depends_on : tuple of str
        At most three columns, strongest first.
    terms : tuple of tuple of str
        Columns of each smooth function that explains it, strongest first.
    shapes : tuple of SmoothShape
        Those functions, with bands.
    form : Form or None
        A short formula that explains nearly as much.
    """

    joint: int
    fraction: float
    depends_on: tuple[str, ...]
    terms: tuple[tuple[str, ...], ...] = ()
    shapes: tuple[SmoothShape, ...] = field(default=(), repr=False)
    form: Form | None = field(default=None, repr=False)

    def to_dict(self) -> dict[str, Any]:
        """Return it for JSON, joints from 1."""
        return {
            "joint": self.joint + 1,
            "fraction": self.fraction,
            "depends_on": list(self.depends_on),
            "form": None if self.form is None else self.form.to_dict(),
            "shape": [shape.to_dict() for shape in self.shapes],
        }

    def as_effect_code(self) -> str:
        """Return lines of Python that register it as an effect of one's own.

        Their coefficients are free; `own_effects` tells how they are placed as well.
        """
        from lieid_casadi.diagnosis.residual.user_effect_code import own_effects

        return own_effects([self]).code

    def plot(self, ax: Axes | None = None) -> Figure:
        """Draw the strongest smooth function: a curve with its band, or a map; not shown."""
        from lieid_casadi.diagnosis.residual.shape_plots import plot_shapes

        return plot_shapes([self], ax)


def smooth_bank(
    signals: Sequence[SegmentSignals],
    runs: Sequence[Runs],
    *,
    ranges: Ranges | None = None,
) -> Bank[Smooth]:
    """Return smooth functions of every signal on every joint, filtered, on its runs.

    ``ranges`` are those of other signals, for the same functions.
    """
    n = len(runs)
    ranges = ranges_of(signals) if ranges is None else ranges
    bases = [bases_of(s, ranges) for s in signals]
    tried: list[Smooth] = []
    size: list[int] = []
    on_joint: list[list[tuple[int, Array]]] = [[] for _ in runs]
    first = 0
    for names in _terms(n, "temp1" in bases[0]):
        values = np.concatenate(
            [s.segment.filter(product_of(b, names)) for s, b in zip(signals, bases, strict=True)]
        )
        for joint in _joints_of(names, n):
            tried.append(Smooth(joint, names, values.shape[1]))
            size.append(values.shape[1])
            on_joint[joint].append((first, values[runs[joint].all]))
            first += values.shape[1]
    order = range(len(tried))
    return assemble(tried, list(order), [0] * len(tried), size, on_joint, runs)


def smooth_columns(bank: Bank[Smooth], u: Unexplained) -> Array:
    """Return the columns (R, k) of all functions of what an unexplained part depends on."""
    wanted = set(u.depends_on)
    groups = [
        g for g, c in enumerate(bank.candidates) if c.joint == u.joint and wanted >= set(c.signals)
    ]
    return np.hstack([column_stack(bank, g) for g in groups])


def unexplained(
    bank: Bank[Smooth],
    white: tuple[Bank[Smooth], Baseline],
    baseline: Baseline,
    folds: NDArray[np.intp],
    *,
    seed: int,
) -> tuple[Unexplained, ...]:
    """Return the joints whose residual follows signals, first where most is explained.

    Parameters
    ----------
    bank, baseline
        On plain rows, where fractions are measured.
    white
        Both on whitened rows, for the test.
    """
    screening = screen(*white)
    if not len(screening.gain):
        return ()
    family = Family.of(screening, seed=seed)
    found = []
    for joint in range(len(baseline.ends) - 1):
        own = [g for g, c in enumerate(bank.candidates) if c.joint == joint]
        rows = baseline.joint(joint)
        variance = float(np.sum(baseline.residual[rows] ** 2))
        spread = np.mean(white[1].residual[white[1].joint(joint)] ** 2)
        sure = [
            g
            for g in own
            if family.log10_p(screening.gain[g] / max(spread, 1.0), int(screening.rank[g]))
            < np.log10(LEVEL)
        ]
        names, terms, fraction = _strongest(bank, baseline, sure, folds, variance)
        if names and fraction >= (LEAST_SLOW if names[0] == "t" else LEAST):
            part = Unexplained(joint, min(fraction, 1.0), names, terms)
            found.append((fraction * variance, part))
    return tuple(u for _, u in sorted(found, key=lambda pair: -pair[0]))


def _strongest(
    bank: Bank[Smooth],
    baseline: Baseline,
    groups: Sequence[int],
    folds: NDArray[np.intp],
    variance: float,
) -> tuple[tuple[str, ...], tuple[tuple[str, ...], ...], float]:
    """Add the group with the largest held-out gain until what is added is little."""
    names: list[str] = []
    terms: list[tuple[str, ...]] = []
    total = 0.0
    while len(names) < MOST_SIGNALS:
        gain = screen(bank, baseline).gain
        best = sorted(groups, key=lambda g: -gain[g])[:6]
        gains = [cross_validated_gain(column_stack(bank, g), baseline, folds) for g in best]
        if not gains or max(gains) < max(0.5 * LEAST * variance, ADDS * total):
            break
        winner = best[int(np.argmax(gains))]
        fresh = [s for s in bank.candidates[winner].signals if s not in names]
        names += fresh[: MOST_SIGNALS - len(names)]
        terms.append(bank.candidates[winner].signals)
        total += max(gains)
        baseline = baseline.with_columns(column_stack(bank, winner))
        groups = [g for g in groups if g != winner]
    return tuple(names), tuple(terms), total / variance if variance > 0.0 else 0.0


def _terms(n: int, warm: bool) -> list[tuple[str, ...]]:
    single: list[tuple[str, ...]] = [(f"{s}{i + 1}",) for s in ("q", "dq", "ddq") for i in range(n)]
    single += [(f"load{i + 1}",) for i in range(n)] + [("t",)]
    if warm:
        single += [(f"temp{i + 1}",) for i in range(n)]
    pairs = [(f"q{i + 1}", f"dq{j + 1}") for i in range(n) for j in range(n)]
    pairs += [
        (f"{s}{i + 1}", f"{s}{j + 1}") for s in ("q", "dq") for i in range(n) for j in range(i)
    ]
    return single + pairs


def _joints_of(names: tuple[str, ...], n: int) -> list[int]:
    """Return the joints that a term is tried on: all; a pair and loads only on their own."""
    indices = {int("".join(c for c in s if c.isdigit()) or 0) - 1 for s in names}
    if len(names) == 1 and not names[0].startswith(("load", "temp")):
        return list(range(n))
    return sorted(indices)


def ranges_of(signals: Sequence[SegmentSignals]) -> Ranges:
    """Return lowest and highest values (2, n) of each signal."""
    ranges = {}
    for name in ("q", "dq", "ddq", "load", "temperature", "time"):
        values = np.concatenate([s.values[name] for s in signals])
        ranges[name] = np.percentile(values, [1.0, 99.0], axis=0)
    return ranges


def bases_of(signals: SegmentSignals, ranges: Ranges) -> dict[str, Array]:
    """Return basis functions (K, b) of each column along a segment."""
    bases = {}
    for name, column in (("q", "q"), ("dq", "dq"), ("ddq", "ddq"), ("load", "load")):
        for i in range(signals.segment.n):
            low, high = ranges[name][:, i]
            values = signals.values[name][:, i]
            half = max(0.5 * (high - low), 1e-9)
            x = np.clip((values - 0.5 * (low + high)) / half, -1.2, 1.2)
            if name == "dq":
                reach = max(abs(low), abs(high), 1e-9)
                x, sign = values / reach, signals.values["sign"][:, i]
                bases[f"{column}{i + 1}"] = np.column_stack(
                    [sign, np.abs(x), x, x * np.abs(x), x**3, np.exp(-((x / 0.1) ** 2)) * sign]
                )
            elif name == "q":
                bases[f"{column}{i + 1}"] = np.column_stack(
                    [np.cos(np.pi * 0.5 * k * (x + 1.0)) for k in range(1, 9)]
                )
            else:
                bases[f"{column}{i + 1}"] = np.polynomial.legendre.legvander(x, 5)[:, 1:]
    part = signals.values["time"][:, 0] / max(float(ranges["time"][1, 0]), 1e-9)
    bases["t"] = np.cos(np.pi * part[:, None] * np.arange(1, SLOW + 1))
    if signals.segment.temperature is not None:
        for i in range(signals.segment.n):
            low, high = ranges["temperature"][:, i]
            x = (signals.values["temperature"][:, i] - low) / max(high - low, 1e-6) * 2.0 - 1.0
            bases[f"temp{i + 1}"] = np.polynomial.legendre.legvander(x, 2)[:, 1:]
    return bases


def product_of(bases: dict[str, Array], names: tuple[str, ...]) -> Array:
    """Return the smooth functions (K, b) of one or two columns."""
    if len(names) == 1:
        return bases[names[0]]
    first, second = (bases[name] for name in names)
    first, second = first if is_own_friction(names) else first[:, :4], second[:, :4]
    return np.asarray(np.einsum("ka,kb->kab", first, second).reshape(len(first), -1))


def is_own_friction(names: tuple[str, ...]) -> bool:
    """Whether two columns are angle and velocity of one joint, which may rub at a narrow angle."""
    return len(names) == 2 and names[0][0] == "q" and names[1] == f"d{names[0]}"
