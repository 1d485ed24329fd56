"""Signals of one segment on a uniform grid; a long segment in windows, with the same result."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import binary_opening

from lieid_casadi.recording.arrays import Array, Mask
from lieid_casadi.recording.processing.filtering import (
    central_difference,
    lowpass,
    smooth_at,
    straight_at,
)
from lieid_casadi.recording.processing.overlap_windows import filter_memory
from lieid_casadi.recording.processing.robust_loess import robust_loess
from lieid_casadi.recording.processing.velocity import (
    RawSamples,
    VelocitySource,
    velocity_source,
)
from lieid_casadi.recording.recording import Recording
from lieid_casadi.recording.sample_timing import uniform_count

#: Least time in the dead zone, s, that counts as rest (stiction holds the joint).
REST_TIME = 0.03
#: Band of q, dq and ddq in cut-offs, and least band in Hz: the filter of the columns alone limits
#: the band further, and the duration of reversals and rests does not depend on the cut-off.
MOTION_BAND, LEAST_BAND = 3.0, 20.0
#: Least rate of the grid, in cut-offs and in Hz, so that steps of sgn(dq) stay sharp.
GRID_OVER_CUTOFF, LEAST_GRID = 20.0, 120.0
#: Instants that are filtered at once; longer segments are processed in windows of this length.
WINDOW = 1 << 16
#: Number of samples of a long segment, and rows of each, from which its noise is estimated.
NOISE_SAMPLES, NOISE_ROWS = 16, 1 << 14
#: Rows beyond a window that interpolation needs.
NEIGHBOURS = 4

Rows = Callable[[int, int], Recording]


@dataclass(frozen=True)
class UniformGrid:
    """``count`` instants from ``start`` to ``end``, s; every step-th is kept."""

    start: float
    end: float
    count: int
    step: int

    @classmethod
    def of(cls, t: Array, rate: float, cutoff: float) -> UniformGrid:
        """Return the grid of a segment.

        Parameters
        ----------
        t : (N,)
            Stamps, s.
        rate : float
            Approximate rate of the grid, Hz.
        cutoff : float
            Cut-off of the columns, Hz, which determines how many instants are kept.
        """
        count = uniform_count(t, rate)
        rate = (count - 1) / (t[-1] - t[0])
        step = max(1, int(rate / max(GRID_OVER_CUTOFF * cutoff, LEAST_GRID)))
        return cls(float(t[0]), float(t[-1]), count, step)

    @property
    def rate(self) -> float:
        """Hz, before every step-th is kept."""
        return (self.count - 1) / (self.end - self.start)

    def times(self, first: int, last: int) -> Array:
        """Return instants first … last − 1, s."""
        t = self.start + np.arange(first, last) * ((self.end - self.start) / (self.count - 1))
        if last == self.count:
            t[-1] = self.end
        return np.asarray(t, dtype=np.float64)


@dataclass(frozen=True, eq=False)
class GridSignals:
    """Signals of one segment, (K, …) on every step-th instant of the grid; see `Processed`."""

    t: Array
    q: Array
    dq: Array
    ddq: Array
    tau: Array | None
    temperature: Array | None
    moving: Mask
    dead_zone: Array
    rate: float
    command: Array | None = None


def signals_on_grid(
    t: Array,
    rows: Rows,
    rate: float,
    cutoff: float,
    *,
    loess: bool = False,
    allocate: Callable[..., NDArray[Any]] = np.empty,
) -> GridSignals:
    """Return resampled, low-passed and differentiated signals of one segment.

    Parameters
    ----------
    t
        (N,) stamps of the segment.
    rows
        Called with first and last row (excluded): that part of the segment.
    rate, cutoff
        Hz.
    loess
        Smooth ddq and tau by robust local regression; the segment is then processed as a whole.
    allocate
        Makes the arrays of the result from shape and type.
    """
    grid = UniformGrid.of(t, rate, cutoff)
    whole = loess or grid.count <= 2 * WINDOW
    velocity = None if whole else _sampled_velocity(t, rows, grid, cutoff)
    kept = len(range(0, grid.count, grid.step))
    made: dict[str, NDArray[Any]] = {}
    for first, last, start, end in _windows(grid, cutoff, kept if whole else WINDOW // grid.step):
        times = grid.times(start, end)
        low, high = np.searchsorted(t, [times[0], times[-1]])
        low, high = max(int(low) - NEIGHBOURS, 0), min(int(high) + NEIGHBOURS, len(t))
        part = rows(0, len(t)) if whole else rows(low, high)
        signals, velocity = _signals(part, times, grid, cutoff, velocity, loess)
        inside = slice(first * grid.step - start, (last - 1) * grid.step - start + 1, grid.step)
        for name, values in signals.items():
            if name not in made:
                made[name] = allocate((kept, *values.shape[1:]), values.dtype)
            made[name][first:last] = values[inside]
    for array in made.values():
        array.flags.writeable = False
    assert velocity is not None
    return GridSignals(
        t=made["t"],
        q=made["q"],
        dq=made["dq"],
        ddq=made["ddq"],
        tau=made.get("tau"),
        temperature=made.get("temperature"),
        moving=made["moving"],
        dead_zone=velocity.dead_zone,
        rate=grid.rate / grid.step,
        command=made.get("command"),
    )


def _windows(grid: UniformGrid, cutoff: float, size: int) -> Iterator[tuple[int, int, int, int]]:
    """Yield the kept instants of each window, and the instants of the grid that they need."""
    rate, kept = grid.rate, len(range(0, grid.count, grid.step))
    margin = filter_memory(rate, signal_band(cutoff)) + _rest_length(rate) + NEIGHBOURS
    if grid.step > 1:
        margin = max(margin, filter_memory(rate, 0.4 * rate / grid.step, 8))
    for first in range(0, kept, size):
        last = min(first + size, kept)
        start = max(0, first * grid.step - margin)
        end = grid.count if last == kept else min(grid.count, last * grid.step + margin)
        yield first, last, start, end


def _signals(
    part: Recording,
    times: Array,
    grid: UniformGrid,
    cutoff: float,
    velocity: VelocitySource | None,
    loess: bool,
) -> tuple[dict[str, NDArray[Any]], VelocitySource]:
    """Return signals at times of the grid, at its full rate, and the source of the velocity."""
    rate, band = grid.rate, signal_band(cutoff)
    raw = _raw_samples(part, times, rate)
    q = lowpass(raw.q, rate, band)
    if velocity is None:
        velocity = velocity_source([raw], rate, cutoff, band)
    dq = lowpass(raw.velocity(velocity.derived), rate, band)
    if part.ddq is not None:
        ddq = lowpass(smooth_at(part.t, part.ddq, times), rate, band)
    elif np.array_equal(velocity.derived, velocity.accelerates):
        ddq = central_difference(dq, rate)
    else:
        ddq = central_difference(lowpass(raw.velocity(velocity.accelerates), rate, band), rate)
    moving = _moving(dq, velocity.dead_zone, rate)
    signals: dict[str, NDArray[Any]] = {
        "t": times,
        "q": q,
        "dq": np.where(moving, dq, 0.0),
        "ddq": robust_loess(times, ddq, cutoff) if loess else ddq,
        "moving": moving,
    }
    if part.tau is not None:
        tau = straight_at(part.t, part.tau, times)
        tau = robust_loess(times, tau, cutoff) if loess else tau
        if grid.step > 1:
            tau = lowpass(tau, rate, 0.4 * rate / grid.step, order=8)
        signals["tau"] = tau
    if part.temperature is not None:
        signals["temperature"] = straight_at(part.t, part.temperature, times)
    if part.command is not None:
        signals["command"] = straight_at(part.t, part.command, times)
    return signals, velocity


def _raw_samples(part: Recording, times: Array, rate: float) -> RawSamples:
    q = smooth_at(part.t, part.q, times)
    measured = None if part.dq is None else smooth_at(part.t, part.dq, times)
    return RawSamples(q, measured, central_difference(q, rate))


def _sampled_velocity(t: Array, rows: Rows, grid: UniformGrid, cutoff: float) -> VelocitySource:
    """Choose the source of the velocity from samples of a segment that is not in memory."""
    found, count = [], min(NOISE_ROWS, len(t) // NOISE_SAMPLES)
    for first in np.linspace(0, len(t) - count, NOISE_SAMPLES).astype(int):
        part = rows(int(first), int(first) + count)
        times = np.arange(part.t[0], part.t[-1], 1.0 / grid.rate)
        found.append(_raw_samples(part, times, grid.rate))
    return velocity_source(found, grid.rate, cutoff, signal_band(cutoff))


def signal_band(cutoff: float) -> float:
    """Return the band of q, dq and ddq, Hz, for a cut-off of the columns."""
    return max(MOTION_BAND * cutoff, LEAST_BAND)


def _rest_length(rate: float) -> int:
    return max(round(rate * REST_TIME), 2)


def _moving(dq: Array, dead_zone: Array, rate: float) -> Mask:
    """Mark (K, n) where joints do not rest.

    Dry friction is undetermined where stiction holds a joint, even for an instant at a reversal.
    A reversal without stiction passes through the dead zone sooner, and there the velocity's own
    sign is the best estimate.
    """
    structure = np.ones((_rest_length(rate), 1), dtype=bool)
    rest = binary_opening(np.abs(dq) <= dead_zone, structure=structure)
    return np.asarray(~rest)
