"""Checks of a recording: errors for what is certainly wrong, warnings for the rest."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from scipy.integrate import cumulative_trapezoid

from lieid_casadi import errors
from lieid_casadi.arrays import Array, Mask
from lieid_casadi.messages import joints_text
from lieid_casadi.recording import sample_timing
from lieid_casadi.recording.measurement import require_sound
from lieid_casadi.recording.recording import Recording
from lieid_casadi.recording.spectrum import motion_band, resolution
from lieid_casadi.robot.robot import Robot


def check(recording: Recording, robot: Robot | None = None) -> tuple[errors.LieidWarning, ...]:
    """Return the warnings of a recording, checked against a robot where one is given.

    The recording's own warnings come first, then dropouts and irregular stamps, limits, joints at
    rest, rate, torque.

    Raises
    ------
    RecordingError
        What is certainly wrong: NaN or Inf, time that does not increase or is not in seconds,
        another number of joints, degrees, velocities in other units.
    """
    require_sound(recording)
    sample_timing.require_plausible_rate(recording.t, recording.title)
    if robot is not None and robot.n != recording.n:
        raise errors.RecordingError(
            f"{recording.title}: found {recording.n} joints "
            f"(q1…q{recording.n}), expected {robot.n} as the robot {robot.name} has"
        )
    units = check_units(recording, robot)
    require_velocity_units(recording)
    return (
        *recording.warnings,
        *check_time(recording),
        *units,
        *check_still(recording, robot),
        *check_rate(recording),
        *check_torque(recording, robot),
    )


#: Positions beyond the limits by this factor (and half a radian) are not in radians.
FAR_BEYOND = 2.0
#: Two turns: without stated limits, half of the joints beyond this means degrees.
TWO_TURNS = 4.0 * np.pi


def require_plausible_units(recording: Recording, robot: Robot | None = None) -> None:
    """Refuse stamps that are not in seconds and positions that are not in radians."""
    sample_timing.require_plausible_rate(recording.t, recording.title)
    check_units(recording, robot)


def check_units(recording: Recording, robot: Robot | None) -> list[errors.LieidWarning]:
    """Refuse degrees; warn where positions leave the robot's limits."""
    title = recording.title
    revolute, lower, upper = np.ones(recording.n, dtype=bool), *np.full((2, recording.n), np.nan)
    if robot is not None:
        revolute = np.array([joint.revolute for joint in robot.joints])
        lower, upper = robot.limit("position_lower"), robot.limit("position_upper")
    largest = np.max(np.abs(recording.q), axis=0)
    stated = revolute & np.isfinite(lower) & np.isfinite(upper)
    reach = np.where(stated, np.maximum(np.abs(lower), np.abs(upper)), np.inf)
    far = largest > FAR_BEYOND * reach + 0.5
    sure = far.sum() >= 2 or stated.sum() <= 2 or np.any(largest > 10.0 * reach)
    free = revolute & ~stated
    turns = free.sum() >= 2 and np.median(largest[free]) > TWO_TURNS
    if turns or (far.any() and sure):
        joint = int(np.argmax(np.where(free, largest, 0.0) if turns else largest / reach))
        limits = f" where the robot's limits are {lower[joint]:.4g} to {upper[joint]:.4g} rad"
        raise errors.RecordingError(
            f"{title}: column q{joint + 1}: found {largest[joint]:.4g}{'' if turns else limits}, "
            "expected radians; if these are degrees, convert with --units deg (units='deg' in "
            "Python)"
        )
    with np.errstate(invalid="ignore"):
        over = np.maximum(recording.q.max(axis=0) - upper, lower - recording.q.min(axis=0))
        outside = over > 0.02
    if not outside.any():
        return []
    return [
        errors.JointLimitWarning(
            f"{title}: positions of {joints_text(outside)} exceed the robot's limits by up to "
            f"{over[outside].max():.3g}: check the zero pose, the robot and the unit"
        )
    ]


#: Mean step over median step beyond which stamps come in clusters.
CLUSTERED = 2.0


def check_time(recording: Recording) -> Iterator[errors.LieidWarning]:
    """Report lost samples, gaps that split the recording into segments, and clustered stamps."""
    steps, period = np.diff(recording.t), sample_timing.sample_period(recording.t)
    steps[np.isin(recording.t[:-1], recording.pauses)] = 0.0
    lost = steps > sample_timing.dropout_limit(recording.t)
    if lost.any():
        first = recording.t[int(np.argmax(lost))]
        gaps = int(np.sum(steps > sample_timing.gap_limit(recording.t)))
        split = f"; split into {gaps + 1} segments at the gaps" if gaps else "; interpolated"
        yield errors.DropoutWarning(
            f"{recording.title}: {int(lost.sum())} dropouts, the longest "
            f"{steps.max():.3g} s at a sample period of {period:.3g} s, "
            f"the first at t = {first:.6g} s{split}"
        )
    mean = 1.0 / sample_timing.mean_rate(recording.t)
    if mean >= CLUSTERED * period:
        yield errors.IrregularTimeWarning(
            f"{recording.title}: the stamps come in clusters (median step {period:.3g} s, mean "
            f"step {mean:.3g} s): these look like times of arrival; record the time of each "
            "measurement, or velocities and accelerations are wrong"
        )


DEGREES = 180.0 / np.pi
#: Ratio of the integral of dq to the change of q, and the unit that it shows.
ANGLE_RATIOS = {
    "dq in degrees per second and q in radians: convert dq with numpy.deg2rad": DEGREES,
    "q in degrees and dq in radians per second: convert q with numpy.deg2rad": 1.0 / DEGREES,
}
#: A joint that stays within this never moves, rad (a tenth of it in m).
STILL = 1e-3
#: Length of a block in which a joint's way is compared with its velocity, s: short against the
#: motion of an arm, long against sensor noise. Blocks that are compared, at least.
BLOCK_SECONDS, FEWEST_BLOCKS = 0.04, 8


@dataclass(frozen=True, eq=False)
class _VelocityGains:
    """Size of the integral of dq relative to the change of q, and their correlation, (n,)."""

    gain: Array
    correlation: Array
    moving: Mask

    def joint_with(self, ratio: float) -> int | None:
        """Return the first joint, if most of the moving ones have this gain."""
        found = self.moving & (np.abs(self.gain / ratio - 1.0) < 0.15) & (self.correlation > 0.9)
        return int(np.argmax(found)) if found.sum() > 0.5 * self.moving.sum() else None


def _velocity_gains(recording: Recording) -> _VelocityGains | None:
    """Compare dq with q, by their changes over blocks within segments; None without motion."""
    if recording.dq is None:
        return None
    size = max(1, round(BLOCK_SECONDS * recording.rate))
    ways, integrals = [np.empty((0, recording.n))], [np.empty((0, recording.n))]
    for segment in recording.segments():
        if len(segment) >= 3 * size and segment.dq is not None:
            integral = np.asarray(cumulative_trapezoid(segment.dq, segment.t, axis=0, initial=0))
            ways.append(np.diff(segment.q[::size], axis=0))
            integrals.append(np.diff(integral[::size], axis=0))
    way, integral = np.concatenate(ways), np.concatenate(integrals)
    squares, others = np.sum(way**2, axis=0), np.sum(integral**2, axis=0)
    moving = np.ptp(recording.q, axis=0) > 10.0 * STILL
    moving &= np.sqrt(squares / max(len(way), 1)) > 3.0 * resolution(recording.q)
    if len(way) < FEWEST_BLOCKS or not moving.any():
        return None
    with np.errstate(invalid="ignore", divide="ignore"):
        gain = np.sqrt(others / squares)
        correlation = np.sum(way * integral, axis=0) / np.sqrt(squares * others)
    # a joint exactly at rest has no gain; it is not among those that move
    return _VelocityGains(np.nan_to_num(gain, posinf=0.0), np.nan_to_num(correlation), moving)


def unit_of_velocity(recording: Recording) -> tuple[str, float] | None:
    """Return the unit of time in which dq is the derivative of q, if it is not s, and the gain."""
    found = _velocity_gains(recording)
    if found is None:
        return None
    for unit in sample_timing.TIME_NAMES:
        joint = found.joint_with(1.0 / sample_timing.TIME_UNITS[unit])
        if joint is not None:
            return unit, float(found.gain[joint])
    return None


def require_velocity_units(recording: Recording) -> None:
    """Refuse velocities that are the derivative of the positions in other units."""
    found = _velocity_gains(recording)
    if found is None:
        return
    meanings = ANGLE_RATIOS | {
        f"t in {name}: convert with --units {unit}": 1.0 / sample_timing.TIME_UNITS[unit]
        for unit, name in sample_timing.TIME_NAMES.items()
    }
    for meaning, ratio in meanings.items():
        joint = found.joint_with(ratio)
        if joint is not None:
            raise errors.RecordingError(
                f"{recording.title}: column dq{joint + 1}: found {found.gain[joint]:.3g} times the "
                f"derivative of q{joint + 1}, expected 1; this looks like {meaning}"
            )


def check_still(recording: Recording, robot: Robot | None) -> Iterator[errors.LieidWarning]:
    """Name the joints that never move."""
    limits = np.full(recording.n, STILL)
    if robot is not None:
        limits = np.array([STILL if joint.revolute else 0.1 * STILL for joint in robot.joints])
    still = np.ptp(recording.q, axis=0) < limits
    if still.any():
        yield errors.JointStillWarning(
            f"{recording.title}: {joints_text(still)} never moved: friction and inertia of a "
            "joint at rest are not identifiable"
        )


def check_rate(recording: Recording) -> Iterator[errors.LieidWarning]:
    """Report motion near the Nyquist frequency."""
    band = motion_band(recording)
    if band is not None and band >= 0.1 * recording.rate:
        yield errors.LowRateWarning(
            f"{recording.title}: {recording.rate:.3g} Hz is a low rate for motion "
            f"up to {band:.3g} Hz, expected {10.0 * band:.3g} Hz or more: accelerations are "
            "underestimated"
        )


def check_torque(recording: Recording, robot: Robot | None) -> Iterator[errors.LieidWarning]:
    """Report torques that are constant, clipped or beyond the robot's limits."""
    if recording.tau is None:
        return
    title = recording.title
    constant = np.ptp(recording.tau, axis=0) == 0.0
    if constant.any():
        values = ", ".join(f"{value:g}" for value in np.unique(recording.tau[0, constant])[:4])
        yield errors.ConstantTorqueWarning(
            f"{title}: torque of {joints_text(constant)} is {values} N·m in every row: was it "
            "recorded? The parameters of these joints are not identifiable from it"
        )
    magnitude = np.abs(recording.tau)
    at_limit = np.zeros(recording.n, dtype=bool)
    if robot is not None:
        with np.errstate(invalid="ignore"):
            at_limit = np.sum(magnitude >= 0.999 * robot.limit("torque"), axis=0) >= 3
    clipped = clipped_joints(recording) & ~at_limit
    if clipped.any():
        level = float(magnitude[:, clipped].max(axis=0)[0])
        yield errors.TorqueClippedWarning(
            f"{title}: torque of {joints_text(clipped)} stays at its largest value "
            f"({level:.4g}): it seems to be clipped"
        )
    if at_limit.any():
        yield errors.TorqueClippedWarning(
            f"{title}: torque of {joints_text(at_limit)} reaches the robot's torque limit"
        )


def clipped_joints(recording: Recording) -> Mask:
    """Return the joints (n,) whose torque stays at its largest value while they move."""
    if recording.tau is None:
        return np.zeros(recording.n, dtype=bool)
    magnitude = np.abs(recording.tau)
    dq = recording.dq
    if dq is None:
        dq = np.gradient(recording.q, recording.t, axis=0)
    top = magnitude >= 0.999 * magnitude.max(axis=0)
    speed = np.array([np.median(np.abs(v[at])) for v, at in zip(dq.T, top.T, strict=True)])
    moving = speed > 0.01 * np.abs(dq).max(axis=0)  # holding still is no clipping
    return np.asarray(moving & [_stuck_at_top(column) for column in magnitude.T])


def _stuck_at_top(magnitude: Array) -> bool:
    """Return whether far more values are at the top than just below it (2.4 times at a peak)."""
    top = float(magnitude.max())
    if top == 0.0:
        return False
    width = max(1e-3 * top, 0.75 * float(resolution(magnitude[:, None])[0] or top))
    at_top = int(np.sum(magnitude > top - width))
    below = int(np.sum((magnitude > top - 2.0 * width) & (magnitude <= top - width)))
    return at_top >= max(10, 0.003 * magnitude.size) and at_top > 6 * below
