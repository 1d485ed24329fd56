"""From recordings to uniform signals, and the one filter for torque and regressor columns."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike
from scipy.interpolate import CubicSpline, PPoly
from scipy.ndimage import binary_opening, maximum_filter1d

from lieid_casadi.arrays import Array, Mask
from lieid_casadi.errors import (
    DriveProtectionWarning,
    LateVelocityWarning,
    LieidWarning,
    RecordingError,
    ShortSegmentWarning,
)
from lieid_casadi.messages import joints_text
from lieid_casadi.recording import filtering, spectrum
from lieid_casadi.recording.measurement import read_only
from lieid_casadi.recording.recording import Recording
from lieid_casadi.recording.repairs import late_velocities, without_repeats
from lieid_casadi.recording.sample_timing import require_plausible_rate, sample_rate

#: Largest weight of samples at rest in a filtered sample that counts as moving.
LARGEST_REST_WEIGHT = 0.1
#: Least rate of the grid, in cut-offs and in Hz, so that steps of sgn(dq) stay sharp.
GRID_OVER_CUTOFF, LEAST_GRID = 20.0, 120.0
#: Least time in the dead zone, s, that counts as rest (stiction holds the joint).
REST_TIME = 0.03
#: Band of q, dq and ddq in cut-offs, and least band in Hz: the filter of the columns alone limits
#: the band further, and the duration of reversals and rests does not depend on the cut-off.
MOTION_BAND, LEAST_BAND = 3.0, 20.0
#: The derivative replaces the measured velocity if its noise over the band of the motion is lower
#: by this factor: it contains no motion between two samples.
MUCH_LESS_NOISE = 2.0
#: The acceleration is computed from it if its noise at the cut-off is lower by this factor:
#: differences amplify noise, and the columns' filter removes higher frequencies.
LESS_NOISE = 1.2
#: Rates at which noise is compared, in cut-offs and in bands of the motion: it is then that of
#: the upper half below Nyquist, where motion leaves little.
RATE_OVER_CUTOFF, RATE_OVER_BAND = 4.0, 2.5
#: Samples in a period of the cut-off, or of commands, whose torque is as exact as the positions,
#: below which accelerations are differences of sixth order: over two samples they are 17 % small.
FEWEST_SAMPLES = 6.0


@dataclass(frozen=True, kw_only=True)
class Processing:
    """Options of :func:`process`.

    Attributes
    ----------
    cutoff
        Cut-off of the low-pass on torque and columns, Hz; None chooses it from the spectrum.
    trim
        Length that is removed at both ends of every segment, s, because of the filter's edges.
    """

    cutoff: float | None = None
    trim: float = 0.5

    def __post_init__(self) -> None:
        if self.cutoff is not None and not (np.isfinite(self.cutoff) and self.cutoff > 0.0):
            raise RecordingError(f"cutoff is {self.cutoff}, expected Hz above 0")
        if not (np.isfinite(self.trim) and self.trim >= 0.0):
            raise RecordingError(f"trim is {self.trim}, expected seconds from 0")


@dataclass(frozen=True, eq=False)
class Processed:
    """One segment on a uniform grid of K instants.

    q, dq and ddq are low-passed well above the cut-off, zero-phase; dq and ddq are derived from q
    where that has clearly less noise than the measured dq, or that is late.
    """

    t: Array  # (K,) s, on the recording's own clock
    q: Array  # (K, n)
    dq: Array  # 0 where a joint rests
    ddq: Array
    tau: Array | None  # resampled, not low-passed: `filter` does that
    temperature: Array | None  # °C
    payload_label: str | None  # of the whole segment
    recording: Recording  # the rows of this segment
    rate: float  # Hz
    cutoff: float  # Hz
    dead_zone: Array  # (n,) speed below which a joint counts as at rest, rad/s
    moving: Mask  # (K, n) False where stiction may hold a joint
    options: Processing  # with the cut-off that was chosen
    warnings: tuple[LieidWarning, ...] = ()
    command: Array | None = None  # (K, n) resampled, not low-passed
    number: int | None = 0  # of its recording among those of a fit; None if it is none of them

    @property
    def n(self) -> int:
        """Number of joints."""
        return int(self.q.shape[1])

    @property
    def command_error(self) -> Array | None:
        """(K, n) commanded minus measured position within the drives' limits, if commanded."""
        if self.command is None:
            return None
        error, laws = self.command - self.q, self.recording.drives
        if laws is None:
            return error
        columns = [x.effective_error(error[:, j], self.dq[:, j]) for j, x in enumerate(laws)]
        return np.stack(columns, axis=1)

    def held_command(self, joint: int, delay: float, hold: float, *, parts: int = 1) -> Array:
        """Return the commands (parts, K) of a joint that arrive late and are held for a time, s.

        They are the means over parts of that time, whose middle is late by ``delay``, s. Below half
        of the rate, a signal that is held from sample to sample is the mean of the smooth one over
        the time before: interpolating the samples between two rows would make it smaller.
        """
        assert self.command is not None
        if (key := (joint, parts)) not in self._held or self._held[key][0] != (delay, hold):
            edges = self.t - delay + hold * np.linspace(0.5, -0.5, parts + 1)[:, None]
            inside = np.clip(edges, self.t[0], self.t[-1])
            ends = np.where(edges < self.t[0], *self.command[[0, -1], joint])
            integral = self._command_integrals[joint](inside) + (edges - inside) * ends
            self._held[key] = (delay, hold), -np.diff(integral, axis=0) * parts / hold
        return self._held[key][1]

    @cached_property
    def _held(self) -> dict[tuple[int, int], tuple[tuple[float, float], Array]]:
        """The last `held_command` of each joint and number of parts, and what it is for."""
        return {}

    @cached_property
    def _command_integrals(self) -> list[PPoly]:
        """The integral of the commands of each joint (n) over time, rad·s."""
        assert self.command is not None
        return [CubicSpline(self.t, own).antiderivative() for own in self.command.T]

    @cached_property
    def by_law(self) -> Mask:
        """(K, n) False where overload protection lowers the torque below that of a drive's law."""
        laws = self.recording.drives
        if self.command is None or laws is None:
            return np.ones(self.q.shape, dtype=bool)
        error = self.command - self.q
        columns = [x.protected(self.t, error[:, j], self.dq[:, j]) for j, x in enumerate(laws)]
        return ~np.stack(columns, axis=1)

    @cached_property
    def position_step(self) -> Array:
        """Smallest step (n,) between recorded positions: a count of an encoder, or rounding."""
        return spectrum.resolution(self.recording.q)

    @cached_property
    def rounding_of_ddq(self) -> Array:
        """Error of ddq (K, n) if what it is computed from is rounded again, half a step off."""
        slow = CubicSpline(self.t, filtering.lowpass(self.q, self.rate, self.cutoff))
        fresh, _ = without_repeats(self.recording)
        times = filtering.uniform_time(fresh.t, sample_rate(fresh.t))
        q, dq = (np.round(slow(fresh.t, order), 12) for order in (0, 1))  # rests are constant
        late = late_velocities(fresh, self.cutoff) != 0.0
        exact = replace(fresh, q=q, dq=None if fresh.dq is None else dq)
        coarse = replace(exact, q=spectrum.rounded_as(fresh.q, q))
        if fresh.dq is not None:
            coarse = replace(coarse, dq=spectrum.rounded_as(fresh.dq, dq))
        a, b = (_motion_at(x, times, self.cutoff, late)[2] for x in (exact, coarse))
        return (b - a)[:: -(-len(times) // len(self.t))]

    def __len__(self) -> int:
        return int(self.t.size)

    @cached_property
    def kept(self) -> slice:
        """Instants of the grid that are kept after filtering: trimmed, then every step-th."""
        edge = round(self.options.trim * self.rate)
        step = max(1, int(self.rate / (4.0 * self.cutoff)))
        return slice(edge, self.t.size - edge, step)

    def filter(self, x: ArrayLike) -> Array:
        """Low-pass along axis 0, trim and decimate: (K, ...) -> (M, ...).

        Linear and zero-phase; the same for torque and for every regressor column, so that
        tau = Y β still holds. M samples at no less than four times the cut-off.
        """
        values = np.asarray(x)
        if values.shape[:1] != self.t.shape:
            raise RecordingError(f"filter: found shape {values.shape}, expected ({self.t.size}, …)")
        return np.concatenate([self.filter_window(values[w.instants], w) for w in self.windows])

    @cached_property
    def windows(self) -> tuple[filtering.Window, ...]:
        """Windows that can be filtered one by one with the same result as the whole segment."""
        margin = filtering.filter_memory(self.rate, self.cutoff)
        return tuple(filtering.windows(self.t.size, self.kept, margin))

    def filter_window(self, x: Array, window: filtering.Window, axis: int = 0) -> Array:
        """Return the rows of one window of :meth:`filter`."""
        values = np.moveaxis(np.asarray(x, dtype=np.float64), axis, 0)
        low = filtering.lowpass(values, self.rate, self.cutoff)
        return np.moveaxis(low[window.inside], 0, axis)

    @cached_property
    def filtered_time(self) -> Array:
        """(M,) s, instants of the rows that :meth:`filter` returns."""
        return self.t[self.kept]

    @cached_property
    def filtered_torque(self) -> Array:
        """(M, n) torque as :meth:`filter` returns it."""
        assert self.tau is not None  # checked before identification and comparison
        return self.filter(self.tau)

    @cached_property
    def filtered_motion(self) -> tuple[Array, Array, Array]:
        """(M, n) q, dq and ddq as :meth:`filter` returns them."""
        return self.filter(self.q), self.filter(self.dq), self.filter(self.ddq)

    @cached_property
    def filtered_moving(self) -> Mask:
        """(M, n) True where no rest, with undetermined friction, is within the filter."""
        return self.filtered_mask(self.moving & self.by_law)

    def filtered_mask(self, mask: Mask) -> Mask:
        """Return the mask (M, n) of rows whose filter hardly contains instants outside (K, n)."""
        return np.asarray(np.abs(self.filter(mask) - 1.0) < LARGEST_REST_WEIGHT)

    def away_from_reversals(self, reach: float) -> Mask:
        """(M, n) True farther than a time, s, from each reversal and rest of a joint.

        There neither the instant at which dry friction reverses nor its value at rest counts.
        """
        turned = ~self.moving
        turned[1:] |= np.sign(self.dq[1:]) != np.sign(self.dq[:-1])
        size = 2 * round(reach * self.rate) + 1
        return np.asarray(~maximum_filter1d(turned, size, axis=0)[self.kept])


def process(
    recordings: Recording | Sequence[Recording], options: Processing | None = None
) -> tuple[Processed, ...]:
    """Return uniform, differentiated signals of every segment of the recordings.

    Without a cut-off in the options one is chosen for all recordings together: the median of
    :func:`choose_cutoff`. A test is processed with the cut-off of the training data.
    """
    given = [recordings] if isinstance(recordings, Recording) else list(recordings)
    if not given:
        raise RecordingError("no recordings, expected at least one")
    for recording in given:
        require_plausible_rate(recording.t, recording.title)
    options = options or Processing()
    cutoff = options.cutoff or float(np.median([spectrum.choose_cutoff(r) for r in given]))
    options = replace(options, cutoff=cutoff)
    done: list[Processed] = []
    short: list[LieidWarning] = []
    for number, recording in enumerate(given):
        for segment in recording.segments():
            reason = _too_short(segment, cutoff, options.trim)
            if reason:
                short.append(ShortSegmentWarning(reason))
            else:
                done.append(replace(_process_segment(segment, options, cutoff), number=number))
    if not done:
        parts = f"; {len(short)} parts between gaps in time are: check the stamps"
        raise RecordingError(f"{short[0]}{parts if len(short) > len(given) else ''}")
    if short:
        done[0] = replace(done[0], warnings=(*done[0].warnings, *short))
    return tuple(done)


def recording_count(segments: Sequence[Processed]) -> int:
    """Return the number of the recordings of segments."""
    return 1 + max(segment.number or 0 for segment in segments)


def _too_short(segment: Recording, cutoff: float, trim: float) -> str | None:
    left = segment.duration - 2.0 * trim
    if len(segment) >= 5 and left >= 1.0 / cutoff:
        return None
    where = f"{segment.title}: {segment.t[0]:g} to {segment.t[-1]:g} s"
    return (
        f"{where} is too short: {max(left, 0.0):.3g} s remain after trimming {trim:g} s at "
        f"both ends, expected {1.0 / cutoff:.3g} s or more (one period of the cut-off)"
    )


def _process_segment(segment: Recording, options: Processing, cutoff: float) -> Processed:
    fresh, repeated = without_repeats(segment)
    t, rate = fresh.t, sample_rate(fresh.t)
    if cutoff >= filtering.HIGHEST_CUTOFF * rate:
        raise RecordingError(
            f"{segment.title}: cutoff {cutoff:g} Hz, expected less than "
            f"{filtering.HIGHEST_CUTOFF * rate:.3g} Hz at a rate of {rate:.4g} Hz"
        )
    times = filtering.uniform_time(t, rate)
    rate = (times.size - 1) / float(t[-1] - t[0])
    step = max(1, int(rate / max(GRID_OVER_CUTOFF * cutoff, LEAST_GRID)))
    late = late_velocities(fresh, cutoff)
    q, dq, ddq, moving, dead_zone = _motion_at(fresh, times, cutoff, late != 0.0)
    tau = None if fresh.tau is None else filtering.straight_at(t, fresh.tau, times)

    def straight(values: Array | None) -> Array | None:
        return (
            None if values is None else read_only(filtering.straight_at(t, values, times)[::step])
        )

    made = Processed(
        t=read_only(times[::step]),
        q=read_only(q[::step]),
        dq=read_only(dq[::step]),
        ddq=read_only(ddq[::step]),
        tau=None if tau is None else read_only(filtering.decimate(tau, rate, step)),
        temperature=straight(fresh.temperature),
        command=straight(fresh.command),
        payload_label=None if segment.payload_label is None else segment.payload_label[0],
        recording=segment,
        rate=rate / step,
        cutoff=cutoff,
        dead_zone=read_only(dead_zone),
        moving=moving[::step],
        options=options,
        warnings=() if repeated is None else (repeated,),
    )
    if (long := late * rate > 1.0).any():
        seconds = ", ".join(f"{1e3 * x:.3g}" for x in late[long])
        text = f"{segment.title}: recorded velocities are {seconds} ms later than the positions"
        text += f" ({joints_text(long)}), as after a filter: derived from the positions"
        made = replace(made, warnings=(*made.warnings, LateVelocityWarning(text)))
    return replace(made, warnings=(*made.warnings, *_protected(made)))


def _protected(segment: Processed) -> Iterator[LieidWarning]:
    """Yield a warning for each joint whose servo lowered its torque by overload protection."""
    for j, acts in enumerate(~segment.by_law.T):
        ends = np.flatnonzero(np.diff(acts, prepend=False, append=False)).reshape(-1, 2)
        if len(ends):
            law = (segment.recording.drives or ())[j]
            times = ", ".join(f"{segment.t[a]:.4g} to {segment.t[b - 1]:.4g} s" for a, b in ends)
            yield DriveProtectionWarning(
                f"{segment.recording.title}: overload protection of joint {j + 1} (more than "
                f"{law.overload:.3g} N·m for {law.overload_time:g} s) limits its torque to "
                f"{law.protective_limit:.3g} N·m: {times}; left out of fits of the joint. "
                "A simulation has the full torque there"
            )


def _motion_at(
    part: Recording, times: Array, cutoff: float, late: Mask
) -> tuple[Array, Array, Array, Mask, Array]:
    """Return q, dq, ddq, moving (K, n) and dead zones (n,) at uniform times, as in `Processed`."""
    rate = (times.size - 1) / float(times[-1] - times[0])
    band = max(MOTION_BAND * cutoff, LEAST_BAND)
    q = filtering.smooth_at(part.t, part.q, times)
    derivative, count = filtering.central_difference(q, rate), spectrum.resolution(part.q)
    dead_zone = _derivative_dead_zone(count, derivative, rate, band)
    low = rate < FEWEST_SAMPLES * cutoff or (part.command is not None and part.dq is None)
    difference = filtering.sixth_order_difference if low else filtering.central_difference
    velocity, for_acceleration = derivative, difference(q, rate)
    if part.dq is not None:
        measured = filtering.smooth_at(part.t, part.dq, times)
        quantum = spectrum.resolution(part.dq)

        def is_better(factor: float, frequency: float) -> Mask:
            """Mark joints (n,) whose derivative has less noise at a rate than the velocity."""
            step = max(1, int(rate / frequency))
            noise = spectrum.noise_spread(filtering.decimate(measured, rate, step))
            noise = np.hypot(noise, quantum / np.sqrt(12.0 * step))
            return np.asarray(factor * _derivative_noise(count, derivative, rate, step) < noise)

        derived = is_better(MUCH_LESS_NOISE, RATE_OVER_BAND * band) | late
        velocity = np.where(derived, derivative, measured)
        better = is_better(LESS_NOISE, RATE_OVER_CUTOFF * cutoff) | late
        for_acceleration = np.where(better, derivative, measured)
        own = spectrum.noise_dead_zone(measured, kept=band / (0.5 * rate))
        dead_zone = np.where(derived, dead_zone, own)
    dq = filtering.lowpass(velocity, rate, band)
    if part.ddq is None:
        ddq = difference(filtering.lowpass(for_acceleration, rate, band), rate)
    else:
        ddq = filtering.lowpass(filtering.smooth_at(part.t, part.ddq, times), rate, band)
    moving = _moving(dq, dead_zone, rate)
    q = filtering.lowpass(q, rate, band)
    return q, np.where(moving, dq, 0.0), ddq, moving, dead_zone


def _moving(dq: Array, dead_zone: Array, rate: float) -> Mask:
    """Mark (K, n) where joints do not rest.

    Dry friction is undetermined where stiction holds a joint, even for an instant at a reversal.
    A reversal without stiction passes through the dead zone sooner, and there the velocity's own
    sign is the best estimate.
    """
    structure = np.ones((max(round(rate * REST_TIME), 2), 1), dtype=bool)
    rest = binary_opening(np.abs(dq) <= dead_zone, structure=structure)
    return np.asarray(~rest)


def _derivative_noise(quantum: Array, derivative: Array, rate: float, step: int) -> Array:
    """Return the noise (n,) of the derivative, with its errors of truncation and rounding."""
    slow = filtering.decimate(derivative, rate, step)
    # the error of a central difference of step h is h²/6 of the third derivative
    bend = np.diff(slow, n=2, axis=0) / (6.0 * step**2)
    missed = 1.4826 * np.median(np.abs(bend), axis=0)
    # rounding jumps as often as the motion crosses a quantum, at most every sample
    speed = np.sqrt(np.mean(slow**2, axis=0))
    share = np.clip(rate / step * quantum / np.maximum(speed, 1e-300), 1.0 / step, 1.0)
    rounding = quantum * np.sqrt(share / 12.0) * rate * min(0.5 * np.pi / step, np.sqrt(0.5))
    return np.asarray(np.sqrt(spectrum.noise_spread(slow) ** 2 + missed**2 + rounding**2))


def _derivative_dead_zone(quantum: Array, derivative: Array, rate: float, band: float) -> Array:
    """Return the dead zone (n,) of the low-passed derivative; a quantum is one step a period."""
    step = max(1, int(rate / (RATE_OVER_BAND * band)))
    low = filtering.decimate(derivative, rate, step)
    kept = min(1.0, band / (0.5 * rate / step))
    return spectrum.noise_dead_zone(low, kept=kept, quantum=quantum * min(band, 0.5 * rate))
