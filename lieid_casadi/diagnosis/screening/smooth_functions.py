"""Smooth functions of the measured signals: what a residual may follow without being an effect."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lieid_casadi.diagnosis.screening.candidate_columns import CandidateColumns, assemble_columns
from lieid_casadi.diagnosis.screening.effect_columns import SegmentSignals
from lieid_casadi.diagnosis.screening.hysteresis import stops
from lieid_casadi.identification.uncertainty.noise_model import Runs

Array = NDArray[np.float64]
#: Of each signal: lowest and highest values (2, n).
SignalRanges = dict[str, Array]
ANGLE_WAVES = 16  # half waves over the range of an angle: a bump may be narrow
FRICTION_WAVES = 8  # the same in a short recording, and of friction that varies with the angle
FRICTION_CURVES = 6  # friction-like functions of a velocity, which precede the half waves
SPEED_WAVES = 6  # half waves over the speed: friction may have a peak at a narrow range of speeds
#: Filtered functions (M, k) of all segments, by names of signals and number of functions.
SmoothColumns = dict[tuple[tuple[str, ...], int | None], Array]
LOAD_STEP = 0.05  # width of the step where a load changes its sign, relative to the largest load
#: Widths of the hysteresis of a load, relative to half its range.
STOP_WIDTHS = np.array([0.05, 0.1, 0.2, 0.4])
PLAY = "play"  # kind of the functions of a load's past
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
        model's rigid torque, ``play3`` its past (`measured_signal`).
    parameters : int
        Number of basis functions.
    """

    joint: int
    signals: tuple[str, ...]
    parameters: int

    def is_function_of(self, signals: Collection[str]) -> bool:
        """Whether it depends on no other measured signals than these, nor on their past."""
        return {measured_signal(name) for name in self.signals} <= set(signals)

    @property
    def lower(self) -> tuple[float, ...]:
        """Lower bounds of the coefficients: none."""
        return (-np.inf,) * self.parameters


def smooth_candidates(
    signals: Sequence[SegmentSignals],
    runs: Sequence[Runs],
    *,
    ranges: SignalRanges | None = None,
    known: SmoothColumns | None = None,
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
    known : SmoothColumns, optional
        Columns that depend on the measured signals alone; those that are not in it are added.
    """
    n, known = len(runs), {} if known is None else known
    ranges = signal_ranges(signals) if ranges is None else ranges
    bases = [basis_functions(s, ranges) for s in signals]
    functions: list[SmoothFunction] = []
    size: list[int] = []
    on_joint: list[list[tuple[int, Array]]] = [[] for _ in runs]
    first = 0
    terms = _terms(n, "temp1" in bases[0])
    for names, count in [(term, count) for term in terms for count in _counts(term)]:
        values = known.get((names, count))
        if values is None:
            along = [_first_functions(basis, names, count) for basis in bases]
            values = np.concatenate(
                [s.segment.filter(a) for s, a in zip(signals, along, strict=True)]
            )
            if not depends_on_fit(names):
                known[names, count] = values
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
    groups = [
        g for g, c in enumerate(candidates.owners) if c.joint == joint and c.is_function_of(signals)
    ]
    return np.hstack([candidates.stacked(g) for g in groups])


def _terms(n: int, temperature: bool) -> list[tuple[str, ...]]:
    single: list[tuple[str, ...]] = [(f"{s}{i + 1}",) for s in ("q", "dq", "ddq") for i in range(n)]
    single += [(f"{s}{i + 1}",) for s in ("load", PLAY) for i in range(n)] + [("t",)]
    if temperature:
        single += [(f"temp{i + 1}",) for i in range(n)]
    pairs = [(f"q{i + 1}", f"dq{j + 1}") for i in range(n) for j in range(n)]
    pairs += [
        (f"{s}{i + 1}", f"{s}{j + 1}") for s in ("q", "dq") for i in range(n) for j in range(i)
    ]
    return single + pairs


def depends_on_fit(names: Sequence[str]) -> bool:
    """Whether a function of these signals changes with the fitted model."""
    return any(measured_signal(name).startswith("load") for name in names)


def _joints_of(names: tuple[str, ...], n: int) -> list[int]:
    """Return the joints on which a term is tried: all; pairs and loads only on their own."""
    indices = {int("".join(c for c in s if c.isdigit()) or 0) - 1 for s in names}
    if len(names) == 1 and not names[0].startswith(("load", PLAY, "temp")):
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
    accelerations, loads and temperatures. Loads also have a step and a bend at zero, and stops
    (`hysteresis`) under the name ``play``.
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
                x, sign = np.clip(values / reach, -1.2, 1.2), signals.values["sign"][:, i]
                peaks = np.cos(np.pi * np.abs(x)[:, None] * np.arange(1, SPEED_WAVES + 1))
                near = np.exp(-((x / 0.1) ** 2))
                basis = np.column_stack(
                    [sign, np.abs(x), x, x * np.abs(x), x**3, sign * near, sign[:, None] * peaks]
                )
            elif name == "q":
                waves = [np.cos(np.pi * 0.5 * k * (x + 1.0)) for k in range(1, ANGLE_WAVES + 1)]
                basis = np.column_stack(waves)
            else:
                basis = np.polynomial.legendre.legvander(x, 5)[:, 1:]
            if name == "load":  # the torque may step or bend where a load changes its sign
                part = values / max(abs(low), abs(high), 1e-9)
                basis = np.column_stack([basis, np.tanh(part / LOAD_STEP), np.abs(part)])
            bases[f"{name}{i + 1}"] = basis
    for i, columns in enumerate(_of_past_loads(signals, ranges)):
        bases[f"{PLAY}{i + 1}"] = columns
    part = signals.values["time"][:, 0] / max(float(ranges["time"][1, 0]), 1e-9)
    bases["t"] = np.cos(np.pi * part[:, None] * np.arange(1, HALF_WAVES + 1))
    if signals.segment.temperature is not None:
        for i in range(signals.segment.n):
            low, high = ranges["temperature"][:, i]
            x = (signals.values["temperature"][:, i] - low) / max(high - low, 1e-6) * 2.0 - 1.0
            bases[f"temp{i + 1}"] = np.polynomial.legendre.legvander(x, 2)[:, 1:]
    return bases


def _of_past_loads(signals: SegmentSignals, ranges: SignalRanges) -> list[Array]:
    """Return the stops (K, w) of each joint's load, relative to their widths."""
    low, high = ranges["load"]
    widths = np.maximum(0.5 * (high - low), 1e-9)[:, None] * STOP_WIDTHS
    return list(np.moveaxis(stops(signals.values["load"], widths) / widths, 1, 0))


def measured_signal(name: str) -> str:
    """Return the signal whose past a function depends on, or the name itself."""
    return name.replace(PLAY, "load")


def has_memory(names: Sequence[str]) -> bool:
    """Whether a function depends on the past of a signal, so that it is no curve over it."""
    return any(name.startswith(PLAY) for name in names)


def _counts(names: tuple[str, ...]) -> tuple[int | None, ...]:
    """Return the numbers of basis functions that are tried, None for all of them.

    Of an angle or a velocity alone fewer are tried, too: all need a long recording.
    """
    if len(names) > 1:
        return (None,)
    if names[0].startswith("dq"):
        return (FRICTION_CURVES, None)
    return (FRICTION_WAVES, None) if names[0].startswith("q") else (None,)


def _first_functions(bases: dict[str, Array], names: tuple[str, ...], count: int | None) -> Array:
    """Return the first functions (K, b) of `product_basis`, of one signal with a constant.

    The zero of such a function is arbitrary. A model with a free offset contains the constant.

    Parameters
    ----------
    bases : dict
    names : tuple of str
    count : int or None
        None for all.
    """
    functions = product_basis(bases, names)[:, :count]
    return np.column_stack([np.ones(len(functions)), functions]) if len(names) == 1 else functions


def product_basis(bases: dict[str, Array], names: tuple[str, ...]) -> Array:
    """Return the basis functions (K, b) of one column, or products of those of two."""
    if len(names) == 1:
        return bases[names[0]]
    first, second = (bases[name] for name in names)
    waves = FRICTION_WAVES if is_friction_by_angle(names) else 4
    first, second = first[:, :waves], second[:, :4]
    return np.asarray(np.einsum("ka,kb->kab", first, second).reshape(len(first), -1))


def is_friction_by_angle(names: tuple[str, ...]) -> bool:
    """Whether two columns are angle and velocity of one joint.

    Friction may increase at a narrow range of angles, which takes more functions of the angle.
    """
    return len(names) == 2 and names[0][0] == "q" and names[1] == f"d{names[0]}"
