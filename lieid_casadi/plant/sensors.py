"""Sensors of the plant: sampling, encoders, torque and temperature sensors."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from lieid_casadi.arrays import Array, Indices
from lieid_casadi.errors import RecordingError
from lieid_casadi.plant.arm import Arm
from lieid_casadi.plant.effects import (
    BiasDrift,
    EncoderOffset,
    TimeShift,
    TorqueDelay,
    TorqueGain,
    TorqueLowpass,
)
from lieid_casadi.plant.ideal_tracking import TrueMotion, move_along
from lieid_casadi.recording import Recording

PerJoint = float | tuple[float, ...]
VELOCITY_SPAN = 0.01  # s, of the positions whose difference is the measured velocity


@dataclass(frozen=True)
class Sensors:
    """Sensor properties; ideal by default. Numbers are for all joints, tuples for each.

    If the rate does not divide that of the motion, the nearest instants are sampled, with their
    true time stamps. The velocity is the true one with noise (``exact``), the central difference of
    the measured position over 10 ms, or not recorded (``none``).
    """

    rate: float | None = 200.0  # Hz; None: every instant
    counts_per_turn: float = 0.0  # of the encoders; 0: no quantization
    counts_per_metre: float = 0.0  # the same for sliding joints
    position_noise: PerJoint = 0.0  # white, before quantization, rad or m
    velocity: Literal["exact", "difference", "none"] = "exact"
    velocity_noise: PerJoint = 0.0  # white, rad/s
    torque_noise: PerJoint = 0.0  # white, N·m
    coloured_noise: PerJoint = 0.0  # standard deviation of first-order noise, N·m
    correlation_time: float = 0.02  # of this noise, s
    torque_step: PerJoint = 0.0  # quantization, N·m; 0: none
    temperature: bool = False  # whether to record temperatures (0.1 °C resolution)


def measure(
    arm: Arm, motion: TrueMotion, sensors: Sensors, *, seed: int = 0, name: str = ""
) -> Recording:
    """Return the recording of a motion; the seed is that of the noise.

    RecordingError: the rate is above that of the motion.
    """
    random = [np.random.default_rng([seed, 2, stream]) for stream in range(5)]
    rows = sampled_rows(motion.t, sensors.rate)
    encoder = _encoder(arm, motion, sensors, random[0])
    t = motion.t[rows]
    torque = _torque(arm, motion, t)
    torque = torque + random[1].standard_normal(torque.shape) * _each(sensors.torque_noise)
    if np.any(sensors.coloured_noise):
        torque = torque + _each(sensors.coloured_noise) * coloured_noise(
            t, arm.n, sensors.correlation_time, random[2]
        )
    temperature = None
    if sensors.temperature:
        noisy = motion.temperature[rows] + 0.05 * random[4].standard_normal(torque.shape)
        temperature = _quantized(noisy, np.asarray(0.1))
    return Recording.from_arrays(
        t,
        encoder[rows],
        _velocity(motion, encoder, rows, sensors, random[3]),
        _quantized(torque, _each(sensors.torque_step)),
        temperature=temperature,
        name=name,
    )


def measure_along(
    arm: Arm,
    t: ArrayLike,
    q: ArrayLike,
    dq: ArrayLike,
    ddq: ArrayLike,
    *,
    sensors: Sensors | None = None,
    seed: int = 0,
    name: str = "",
) -> Recording:
    """Measure an arm that tracks a motion perfectly; much faster than a simulation.

    The motion (N, n) of the links at times (N,) must be consistent. Sensors are ideal by default,
    with one row per instant; the seed is that of the noise and of dry friction at rest.
    """
    motion = move_along(arm, t, q, dq, ddq, seed=seed)
    return measure(arm, motion, sensors or Sensors(rate=None), seed=seed, name=name)


def sampled_rows(t: Array, rate: float | None) -> Indices:
    """Return the indices nearest to samples at ``rate`` Hz, or all of them for None.

    RecordingError: the rate is above that of t.
    """
    if rate is None:
        return np.arange(t.size)
    own = (t.size - 1) / (t[-1] - t[0])
    if rate > own * (1.0 + 1e-9):
        raise RecordingError(
            f"sensors at {rate:g} Hz on a motion at {own:g} Hz; expected at most that"
        )
    ticks = np.arange(int((t[-1] - t[0]) * rate + 1e-9) + 1) * (own / rate)
    rows: Indices = np.floor(ticks + 0.5 + 1e-9).astype(np.intp)
    return rows


def coloured_noise(t: Array, n: int, correlation_time: float, random: np.random.Generator) -> Array:
    """Return first-order stationary noise (N, n) of unit variance, correlation exp(−Δt/time)."""
    noise = random.standard_normal((t.size, n))
    keep = np.exp(-np.diff(t) / correlation_time)[:, None]
    noise[1:] *= np.sqrt(1.0 - keep**2)
    for k in range(1, t.size):
        noise[k] += keep[k - 1] * noise[k - 1]
    return noise


def _encoder(arm: Arm, motion: TrueMotion, sensors: Sensors, random: np.random.Generator) -> Array:
    q = motion.motor_q + random.standard_normal(motion.q.shape) * _each(sensors.position_noise)
    for effect in arm.effects_of(EncoderOffset):
        q[:, effect.joint] -= effect.offset
    turn = 2.0 * np.pi / sensors.counts_per_turn if sensors.counts_per_turn else 0.0
    metre = 1.0 / sensors.counts_per_metre if sensors.counts_per_metre else 0.0
    return _quantized(q, np.array([turn if j.revolute else metre for j in arm.robot.joints]))


def _velocity(
    motion: TrueMotion, encoder: Array, rows: Indices, sensors: Sensors, random: np.random.Generator
) -> Array | None:
    if sensors.velocity == "none":
        return None
    noise = random.standard_normal((rows.size, encoder.shape[1])) * _each(sensors.velocity_noise)
    if sensors.velocity == "exact":
        return motion.motor_dq[rows] + noise
    half = max(1, round(0.5 * VELOCITY_SPAN / float(np.median(np.diff(motion.t)))))
    before, after = np.maximum(rows - half, 0), np.minimum(rows + half, motion.t.size - 1)
    span = (motion.t[after] - motion.t[before])[:, None]
    return (encoder[after] - encoder[before]) / span + noise


def _torque(arm: Arm, motion: TrueMotion, t: Array) -> Array:
    """Return noiseless torque measurements at t: filter, then delay, gain and drift."""
    from scipy.interpolate import PchipInterpolator

    at = np.searchsorted(motion.t, t)
    recorded = _filtered(arm, motion)
    torque = recorded[at].copy()
    delays = np.full(arm.n, sum((s.delay for s in arm.effects_of(TimeShift)), 0.0))
    for late in arm.effects_of(TorqueDelay):
        delays[late.joint] += late.delay
    for joint in np.flatnonzero(delays):
        when = np.clip(t - delays[joint], motion.t[0], motion.t[-1])
        torque[:, joint] = PchipInterpolator(motion.t, recorded[:, joint])(when)
    for gain in arm.effects_of(TorqueGain):
        torque[:, gain.joint] *= 1.0 + gain.gain
    for drift in arm.effects_of(BiasDrift):
        torque[:, drift.joint] += drift.rate * (t - t.mean())
    return torque


def _filtered(arm: Arm, motion: TrueMotion) -> Array:
    """Return the torque (N, n) behind the low-pass filters of its signal, settled at the start."""
    from scipy.signal import cont2discrete, lfilter, lfilter_zi

    torque = motion.tau.copy()
    step = float(motion.t[-1] - motion.t[0]) / (motion.t.size - 1)
    for lag in arm.effects_of(TorqueLowpass):
        numerator, a, _ = cont2discrete(
            (np.ones(1), np.array([lag.time_constant, 1.0])), step, method="foh"
        )
        b = numerator.ravel()
        settled = lfilter_zi(b, a)
        for joint in range(arm.n) if lag.joint is None else [lag.joint]:
            for _ in range(lag.order):
                signal = torque[:, joint]
                torque[:, joint], _ = lfilter(b, a, signal, zi=settled * signal[0])
    return torque


def _each(value: PerJoint) -> Array:
    return np.asarray(value, dtype=float)


def _quantized(x: Array, step: Array) -> Array:
    stated = step > 0.0
    safe = np.where(stated, step, 1.0)
    return np.asarray(np.where(stated, np.round(x / safe) * safe, x))
