"""Smooth functions of the measured signals: what a residual may follow without being an effect."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lieid_casadi.diagnosis.screening.candidate_columns import CandidateColumns, assemble_columns
from lieid_casadi.diagnosis.screening.effect_columns import SegmentSignals
from lieid_casadi.identification.uncertainty.noise_model import Runs

Array = NDArray[np.float64]
#: Of each signal: lowest and highest values (2, n).
SignalRanges = dict[str, Array]
HALF_WAVES = 12  # over a recording, up to which a function of time counts as smooth


@dataclass(frozen=True)
class SmoothFunction:
    """A smooth function of one or two signals on one joint.

    Attributes
    ----------
    joint : int
        From 0.
    signals : tuple of str
        Named like columns of recordings: ``q3``, ``dq1``, ``temp2``, ``t``; ``load3`` is the
        model's rigid torque.
    parameters : int
        Number of basis functions.
    """

    joint: int
    signals: tuple[str, ...]
    parameters: int

    @property
    def lower(self) -> tuple[float, ...]:
        """Lower bounds of the coefficients: none."""
        return (-np.inf,) * self.parameters


def smooth_candidates(
    signals: Sequence[SegmentSignals],
    runs: Sequence[Runs],
    *,
    ranges: SignalRanges | None = None,
) -> CandidateColumns[SmoothFunction]:
    """Return smooth functions of every signal on every joint, filtered, on its runs.

    Parameters
    ----------
    signals : sequence of SegmentSignals
        One per segment.
    runs : sequence of Runs
        One per joint.
    ranges : dict, optional
        Ranges of other segments, to evaluate the functions that were fitted there.
    """
    n = len(runs)
    ranges = signal_ranges(signals) if ranges is None else ranges
    bases = [basis_functions(s, ranges) for s in signals]
    functions: list[SmoothFunction] = []
    size: list[int] = []
    on_joint: list[list[tuple[int, Array]]] = [[] for _ in runs]
    first = 0
    for names in _terms(n, "temp1" in bases[0]):
        values = np.concatenate(
            [s.segment.filter(product_basis(b, names)) for s, b in zip(signals, bases, strict=True)]
        )
        for joint in _joints_of(names, n):
            functions.append(SmoothFunction(joint, names, values.shape[1]))
            size.append(values.shape[1])
            on_joint[joint].append((first, values[runs[joint].all]))
            first += values.shape[1]
    order = range(len(functions))
    return assemble_columns(functions, list(order), [0] * len(functions), size, on_joint, runs)


def smooth_columns(
    candidates: CandidateColumns[SmoothFunction], joint: int, signals: Sequence[str]
) -> Array:
    """Return the columns (R, k) of all smooth functions of some signals on a joint.

    Parameters
    ----------
    candidates : CandidateColumns
        Of `smooth_candidates`.
    joint : int
        From 0.
    signals : sequence of str
    """
    wanted = set(signals)
    groups = [
        g for g, c in enumerate(candidates.owners) if c.joint == joint and wanted >= set(c.signals)
    ]
    return np.hstack([candidates.stacked(g) for g in groups])


def _terms(n: int, temperature: bool) -> list[tuple[str, ...]]:
    single: list[tuple[str, ...]] = [(f"{s}{i + 1}",) for s in ("q", "dq", "ddq") for i in range(n)]
    single += [(f"load{i + 1}",) for i in range(n)] + [("t",)]
    if temperature:
        single += [(f"temp{i + 1}",) for i in range(n)]
    pairs = [(f"q{i + 1}", f"dq{j + 1}") for i in range(n) for j in range(n)]
    pairs += [
        (f"{s}{i + 1}", f"{s}{j + 1}") for s in ("q", "dq") for i in range(n) for j in range(i)
    ]
    return single + pairs


def _joints_of(names: tuple[str, ...], n: int) -> list[int]:
    """Return the joints on which a term is tried: all; pairs and loads only on their own."""
    indices = {int("".join(c for c in s if c.isdigit()) or 0) - 1 for s in names}
    if len(names) == 1 and not names[0].startswith(("load", "temp")):
        return list(range(n))
    return sorted(indices)


def signal_ranges(signals: Sequence[SegmentSignals]) -> SignalRanges:
    """Return the 1st and 99th percentiles (2, n) of each signal over all segments."""
    ranges = {}
    for name in ("q", "dq", "ddq", "load", "temperature", "time"):
        values = np.concatenate([s.values[name] for s in signals])
        ranges[name] = np.percentile(values, [1.0, 99.0], axis=0)
    return ranges


def basis_functions(signals: SegmentSignals, ranges: SignalRanges) -> dict[str, Array]:
    """Return the basis functions (K, b) of each column along a segment.

    Cosines of angles and of time, friction-like functions of velocities, Legendre polynomials of
    accelerations, loads and temperatures.
    """
    bases = {}
    for name in ("q", "dq", "ddq", "load"):
        for i in range(signals.segment.n):
            low, high = ranges[name][:, i]
            values = signals.values[name][:, i]
            half = max(0.5 * (high - low), 1e-9)
            x = np.clip((values - 0.5 * (low + high)) / half, -1.2, 1.2)
            if name == "dq":
                reach = max(abs(low), abs(high), 1e-9)
                x, sign = values / reach, signals.values["sign"][:, i]
                basis = np.column_stack(
                    [sign, np.abs(x), x, x * np.abs(x), x**3, np.exp(-((x / 0.1) ** 2)) * sign]
                )
            elif name == "q":
                waves = [np.cos(np.pi * 0.5 * k * (x + 1.0)) for k in range(1, 9)]
                basis = np.column_stack(waves)
            else:
                basis = np.polynomial.legendre.legvander(x, 5)[:, 1:]
            bases[f"{name}{i + 1}"] = basis
    part = signals.values["time"][:, 0] / max(float(ranges["time"][1, 0]), 1e-9)
    bases["t"] = np.cos(np.pi * part[:, None] * np.arange(1, HALF_WAVES + 1))
    if signals.segment.temperature is not None:
        for i in range(signals.segment.n):
            low, high = ranges["temperature"][:, i]
            x = (signals.values["temperature"][:, i] - low) / max(high - low, 1e-6) * 2.0 - 1.0
            bases[f"temp{i + 1}"] = np.polynomial.legendre.legvander(x, 2)[:, 1:]
    return bases


def product_basis(bases: dict[str, Array], names: tuple[str, ...]) -> Array:
    """Return the basis functions (K, b) of one column, or products of those of two."""
    if len(names) == 1:
        return bases[names[0]]
    first, second = (bases[name] for name in names)
    first, second = first if is_friction_by_angle(names) else first[:, :4], second[:, :4]
    return np.asarray(np.einsum("ka,kb->kab", first, second).reshape(len(first), -1))


def is_friction_by_angle(names: tuple[str, ...]) -> bool:
    """Whether two columns are angle and velocity of one joint.

    Friction may increase at a narrow range of angles, which takes more functions of the angle.
    """
    return len(names) == 2 and names[0][0] == "q" and names[1] == f"d{names[0]}"
