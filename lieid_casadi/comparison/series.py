"""Measured and predicted torque along a segment, torques of effects, and largest errors."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from scipy.signal import correlate, welch

from lieid_casadi.arrays import Array, Mask
from lieid_casadi.effects import Placement
from lieid_casadi.identification.fit import Fit
from lieid_casadi.identification.prediction import relative_temperature, torque_along
from lieid_casadi.identification.regression.segment_columns import effects_along
from lieid_casadi.recording import Processed


@dataclass(frozen=True, eq=False)
class Series:
    """One segment of a test at M instants; all signals are filtered as in the fit.

    ``time`` (M,) is on the clock of the recording with the name ``recording``, s. All others are
    (M, n): torques in N·m, ``q`` and derivatives in rad, the direction of motion ``sign`` (0 at
    rest), the rigid torque of the model ``load`` (τ_load), and °C.
    """

    recording: str
    time: Array
    measured: Array
    predicted: Array
    q: Array
    dq: Array
    ddq: Array
    sign: Array
    load: Array
    temperature: Array | None = None

    @property
    def error(self) -> Array:
        """Measured − predicted torque (M, n), N·m."""
        return self.measured - self.predicted

    @property
    def moving(self) -> Mask:
        """True where a joint moves (M, n)."""
        return np.asarray(self.sign != 0.0)


def series_along(fit: Fit, segment: Processed) -> tuple[Series, Array]:
    """Return the series of a segment, and its error (K, n) on the grid, not filtered, N·m."""
    assert segment.tau is not None  # checked by compare
    torque = torque_along(fit.compiled, segment, fit.parameters, fit.shapes, fitted=True)
    load = fit.compiled.inverse_dynamics(segment.q, segment.dq, segment.ddq, fit.link_parameters)
    q, dq, ddq = segment.filtered_motion
    temperature = segment.temperature
    if temperature is not None:
        temperature = segment.filter(temperature)
        if fit.temperature_mean is not None:  # temperatures of the segment are relative to it
            temperature = temperature + fit.temperature_mean
    series = Series(
        recording=segment.recording.name,
        time=segment.filtered_time,
        measured=segment.filtered_torque,
        predicted=segment.filter(torque),
        q=q,
        dq=dq,
        ddq=ddq,
        sign=np.where(segment.filtered_moving, np.sign(dq), 0.0),
        load=segment.filter(load),
        temperature=temperature,
    )
    return series, segment.tau - torque


def effect_torques(fit: Fit, segment: Processed) -> list[tuple[Placement, Array]]:
    """Return every placed effect and its torque (K, n), N·m: its columns times its coefficients.

    Their sum and the rigid torque are the model's torque, not filtered, along a segment as
    `process` returns it.
    """
    segment = relative_temperature(segment, fit.temperature_mean)
    columns = effects_along(fit.compiled, segment, fit.shapes, fit.parameters)
    torques = columns * fit.effect_coefficients
    return [(s.placement, torques[:, :, s.columns].sum(axis=2)) for s in fit.model.slots]


PER_JOINT = 3
LAGS = 25  # of a correlation, in samples that are independent if the error is noise
INDEPENDENT = 0.558  # periods of the cut-off: white noise through the filter is uncorrelated then
BEYOND = 2.576  # standard deviations: 99 % of what noise gives lie within
WINDOW = 8.0  # s, of a spectrum: its step is the inverse
PERIODS = 3.0  # of an oscillation over which its size is measured
APART = 1.0  # s, smallest time between two errors of one joint


@dataclass(frozen=True)
class LargeError:
    """An instant at which the error (measured − predicted) of a joint, from 0, is large."""

    recording: str
    time: float
    joint: int
    error: float
    measured: float
    q: float
    dq: float
    moving: bool

    def to_dict(self) -> dict[str, Any]:
        """Return plain data for JSON, with joints from 1."""
        return {**asdict(self), "joint": self.joint + 1}


def largest_errors(series: Sequence[Series]) -> tuple[LargeError, ...]:
    """Return the largest errors of each joint at different times, largest first."""
    found: list[LargeError] = []
    for joint in range(series[0].error.shape[1]):
        peaks = [peak for each in series for peak in _peaks(each, joint)]
        found += sorted(peaks, key=lambda peak: -abs(peak.error))[:PER_JOINT]
    return tuple(found)


def _peaks(series: Series, joint: int) -> list[LargeError]:
    size = np.abs(series.error[:, joint])
    allowed = np.ones(size.size, dtype=bool)
    peaks: list[LargeError] = []
    while len(peaks) < PER_JOINT and allowed.any():
        k = int(np.argmax(np.where(allowed, size, -1.0)))
        allowed &= np.abs(series.time - series.time[k]) >= APART
        signals = (series.error, series.measured, series.q, series.dq)
        error, measured, q, dq = (float(signal[k, joint]) for signal in signals)
        moving, time = bool(series.moving[k, joint]), float(series.time[k])
        found = LargeError(series.recording, time, joint, error, measured, q, dq, moving)
        peaks.append(found)
    return peaks


@dataclass(frozen=True, eq=False)
class Correlation:
    """Correlation of an error with a signal that is ``lag`` s earlier, and its 99 % band."""

    title: str
    lag: Array
    value: Array
    band: float


def residual_correlations(series: Sequence[Series], joint: int, cutoff: float) -> list[Correlation]:
    """Return the auto-correlation of a joint's error, and its correlation with the motion.

    The error is taken at the distance at which white noise through its filter, a Butterworth filter
    of fourth order in both directions, is hardly correlated; what the filter leaves is subtracted.
    Within the bands (Ljung, System Identification, 1999, section 16.6) the error may be noise that
    does not depend on the motion. Segments are not joined; ``cutoff`` is in Hz.
    """
    parts = [s for s in series if len(s.time) > 1]
    if not parts:
        return []
    interval = float(parts[0].time[1] - parts[0].time[0])
    step = max(round(INDEPENDENT / (cutoff * interval)), 1)
    errors, *signals = (
        [getattr(s, name)[::step, joint] for s in parts] for name in ("error", "dq", "ddq")
    )
    own = _covariance(errors, errors)
    count = sum(len(part) for part in errors)
    time: Array = interval * step * np.arange(-LAGS, LAGS + 1, dtype=np.float64)
    white = float(BEYOND / np.sqrt(count))
    beyond = _scaled(own, own[LAGS])[LAGS:] - _of_the_filter(time[LAGS:] * cutoff)
    found = [Correlation("with itself", time[LAGS:], beyond, white)]
    for title, signal in zip(("with the speed", "with the acceleration"), signals, strict=True):
        other = _covariance(signal, signal)
        size = float(np.sqrt(own[LAGS] * other[LAGS]))
        both = float(_scaled(own, own[LAGS]) @ _scaled(other, other[LAGS]))
        spread = float(np.sqrt(max(both, 1.0)))
        found.append(
            Correlation(title, time, _scaled(_covariance(errors, signal), size), white * spread)
        )
    return found


def residual_spectrum(series: Sequence[Series], joint: int, cutoff: float) -> tuple[Array, Array]:
    """Return frequencies up to the cut-off (F,), Hz, and the amplitude of a joint's error there.

    The amplitude (F,), N·m, is the RMS of what lies within one step of the frequency, so that the
    sum of its squares is the mean square of the error (Welch's method, Hann windows).
    """
    parts = [s for s in series if len(s.time) > 8]
    if not parts:
        return np.zeros(0), np.zeros(0)
    rate = float((len(parts[0].time) - 1) / (parts[0].time[-1] - parts[0].time[0]))
    length = min(round(WINDOW * rate), *(len(s.time) for s in parts))
    powers = [welch(s.error[:, joint], rate, nperseg=length, detrend=False) for s in parts]
    frequency = powers[0][0]
    power = np.average([p for _, p in powers], axis=0, weights=[len(s.time) for s in parts])
    shown = frequency <= cutoff
    return frequency[shown], np.sqrt(power[shown] * frequency[1])


def strongest_at(series: Sequence[Series], joint: int, frequency: float) -> float:
    """Return the time at which a joint's error oscillates most with a frequency, s."""
    found = []
    for s in series:
        step = float(s.time[1] - s.time[0])
        window = np.hanning(max(round(PERIODS / (max(frequency, 1e-3) * step)), 3))
        turned = s.error[:, joint] * np.exp(-2j * np.pi * frequency * s.time)
        size = np.abs(np.convolve(turned, window[: len(turned)] / window.sum(), "same"))
        k = int(np.argmax(size))
        found.append((float(size[k]), float(s.time[k])))
    return max(found)[1]


def _covariance(first: Sequence[Array], second: Sequence[Array]) -> Array:
    """Return sums of first(t)·second(t − lag) (2 `LAGS` + 1,) over all segments."""
    means = [np.mean(np.concatenate(parts)) for parts in (first, second)]
    total = np.zeros(2 * LAGS + 1)
    for a, b in zip(first, second, strict=True):
        lags = np.arange(-len(a) + 1, len(a))
        near = np.abs(lags) <= LAGS
        total[lags[near] + LAGS] += correlate(a - means[0], b - means[1])[near]
    return total


def _of_the_filter(lag: Array) -> Array:
    """Return the correlation of filtered white noise at lags in periods of the cut-off."""
    frequency = np.linspace(0.0, 3.0, 1000)
    power = (1.0 + frequency**8) ** -2.0
    return np.asarray(np.cos(2.0 * np.pi * np.outer(lag, frequency)) @ power / power.sum())


def _scaled(values: Array, size: float) -> Array:
    return values / size if size > 0.0 else np.zeros_like(values)
