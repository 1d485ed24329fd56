"""Checks of a recording: errors for what is certainly wrong, warnings for the rest."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from lieid_casadi.arrays import Array, Mask
from lieid_casadi.errors import (
    DropoutWarning,
    IrregularTimeWarning,
    JointLimitWarning,
    JointStillWarning,
    LieidWarning,
    LowRateWarning,
    RecordingError,
    UnitsWarning,
    VelocityMismatchWarning,
)
from lieid_casadi.messages import joints_text
from lieid_casadi.recording.consistency import Blocks, block_means, check_torque
from lieid_casadi.recording.measurement import require_sound
from lieid_casadi.recording.recording import Recording
from lieid_casadi.recording.sample_timing import (
    dropout_limit,
    gap_limit,
    mean_rate,
    require_plausible_rate,
    sample_period,
)
from lieid_casadi.recording.spectrum import motion_band
from lieid_casadi.robot.robot import Robot


def check(
    recording: Recording,
    robot: Robot | None = None,
    *,
    nominal_torque: ArrayLike | None = None,
) -> tuple[LieidWarning, ...]:
    """Check a recording, against a robot where one is given.

    Parameters
    ----------
    recording
        Signals of one run.
    robot
        Adds the number of joints and the limits.
    nominal_torque
        (N, n) torque of the robot's nominal model at the recording's rows: adds sign and
        order of the torques. Without it, signs are checked against friction only.

    Returns
    -------
    tuple of LieidWarning
        The recording's own warnings first, then dropouts and irregular stamps, units and
        limits, velocity against position, joints at rest, rate, torque.

    Raises
    ------
    RecordingError
        What is certainly wrong: NaN or Inf, time that does not increase or is not in seconds,
        another number of joints, degrees.
    """
    require_sound(recording)
    require_plausible_rate(recording.t, recording.title)
    _require_joints(recording, robot)
    nominal = _nominal(recording, nominal_torque)
    blocks = block_means(recording, nominal)
    return (
        *recording.warnings,
        *check_time(recording),
        *check_units(recording, robot),
        *check_velocity(recording, blocks),
        *check_still(recording, robot),
        *check_rate(recording),
        *check_torque(recording, blocks, robot),
    )


def _require_joints(recording: Recording, robot: Robot | None) -> None:
    if robot is not None and robot.n != recording.n:
        raise RecordingError(
            f"{recording.title}: found {recording.n} joints "
            f"(q1…q{recording.n}), expected {robot.n} as the robot {robot.name} has"
        )


def _nominal(recording: Recording, nominal_torque: ArrayLike | None) -> Array | None:
    if nominal_torque is None:
        return None
    nominal = np.asarray(nominal_torque, dtype=np.float64)
    if nominal.shape != recording.q.shape:
        raise RecordingError(
            f"nominal_torque has shape {nominal.shape}, expected {recording.q.shape}"
        )
    return nominal


#: Positions beyond the limits by this factor (and half a radian) are not in radians.
FAR_BEYOND = 2.0
#: Two turns: without stated limits, half of the joints beyond this means degrees.
TWO_TURNS = 4.0 * np.pi
#: Faster than the joints of any arm, rad/s; for warnings only.
FASTEST = 30.0
REMEDY = "convert with --units deg (units='deg' in Python)"


def require_plausible_units(recording: Recording, robot: Robot | None = None) -> None:
    """Refuse stamps that are not in seconds and positions that are not in radians."""
    require_plausible_rate(recording.t, recording.title)
    check_units(recording, robot)


def check_units(recording: Recording, robot: Robot | None) -> list[LieidWarning]:
    """Refuse degrees; warn where values look like degrees or leave the robot's limits."""
    title = recording.title
    revolute = np.ones(recording.n, dtype=bool)
    if robot is not None:
        revolute = np.array([joint.revolute for joint in robot.joints])
    lower, upper = _position_limits(recording, robot)
    largest = np.max(np.abs(recording.q), axis=0)
    stated = revolute & np.isfinite(lower) & np.isfinite(upper)
    reach = np.maximum(np.abs(lower), np.abs(upper))
    far = stated & (largest > FAR_BEYOND * reach + 0.5)
    if far.any() and (far.sum() >= 2 or stated.sum() <= 2 or np.any(largest > 10.0 * reach)):
        joint = int(np.argmax(np.where(far, largest / reach, 0.0)))
        raise RecordingError(
            f"{title}: column q{joint + 1}: found {largest[joint]:.4g} where the robot's limits "
            f"are {lower[joint]:.4g} to {upper[joint]:.4g} rad, expected radians; if these are "
            f"degrees, {REMEDY}"
        )
    free = revolute & ~stated
    if free.sum() >= 2 and np.median(largest[free]) > TWO_TURNS:
        joint = int(np.argmax(np.where(free, largest, 0.0)))
        raise RecordingError(
            f"{title}: column q{joint + 1}: found {largest[joint]:.4g}, "
            f"{largest[joint] / (2.0 * np.pi):.0f} turns, expected radians; if these are degrees, "
            f"{REMEDY}"
        )
    return [
        *_suspicious(recording, title, free, revolute),
        *_beyond_limits(recording, title, lower, upper),
    ]


def _suspicious(recording: Recording, title: str, free: Mask, revolute: Mask) -> list[LieidWarning]:
    largest = np.max(np.abs(recording.q), axis=0)
    turns = free & (largest > TWO_TURNS)
    if turns.any():
        return [
            UnitsWarning(
                f"{title}: positions of {joints_text(turns)} exceed two turns "
                f"({largest[turns].max():.4g} rad); if these are degrees, {REMEDY}"
            )
        ]
    if recording.dq is None:
        return []
    fast = revolute & (np.max(np.abs(recording.dq), axis=0) > FASTEST)
    if not fast.any():
        return []
    top = float(np.abs(recording.dq[:, fast]).max())
    return [
        UnitsWarning(
            f"{title}: {joints_text(fast)} reach {top:.4g} rad/s; if these are degrees per second, "
            f"{REMEDY}"
        )
    ]


def _beyond_limits(
    recording: Recording, title: str, lower: Array, upper: Array
) -> list[LieidWarning]:
    with np.errstate(invalid="ignore"):
        over = np.maximum(recording.q.max(axis=0) - upper, lower - recording.q.min(axis=0))
        outside = over > 0.02
    if not outside.any():
        return []
    return [
        JointLimitWarning(
            f"{title}: positions of {joints_text(outside)} exceed the robot's limits by up to "
            f"{over[outside].max():.3g}: check the zero pose, the robot and the unit"
        )
    ]


def _position_limits(recording: Recording, robot: Robot | None) -> tuple[Array, Array]:
    if robot is None:
        unknown = np.full(recording.n, np.nan)
        return unknown, unknown
    lower = np.array([joint.limits.position_lower for joint in robot.joints])
    upper = np.array([joint.limits.position_upper for joint in robot.joints])
    return lower, upper


DEGREES = 180.0 / np.pi
#: Mean step over median step beyond which stamps come in clusters.
CLUSTERED = 2.0
#: Ratio of the integral of dq to the change of q, and the unit that it shows.
UNIT_RATIOS = (
    (DEGREES, "dq in degrees per second and q in radians: convert dq with numpy.deg2rad"),
    (1.0 / DEGREES, "q in degrees and dq in radians per second: convert q with numpy.deg2rad"),
    (1e3, "t in milliseconds: convert with --units ms"),
    (1e6, "t in microseconds: convert with --units us"),
    (1e9, "t in nanoseconds: convert with --units ns"),
)
#: A joint that stays within this never moves, rad (a tenth of it in m).
STILL = 1e-3


def check_time(recording: Recording) -> list[LieidWarning]:
    """Report lost samples, gaps that split the recording into segments, and clustered stamps."""
    return [*_dropouts(recording), *_clusters(recording)]


def _dropouts(recording: Recording) -> list[LieidWarning]:
    steps = np.diff(recording.t)
    steps[np.isin(recording.t[:-1], recording.pauses)] = 0.0
    lost = steps > dropout_limit(recording.t)
    if not lost.any():
        return []
    first = recording.t[int(np.argmax(lost))]
    gaps = int(np.sum(steps > gap_limit(recording.t)))
    split = f"; split into {gaps + 1} segments at the gaps" if gaps else "; interpolated"
    return [
        DropoutWarning(
            f"{recording.title}: {int(lost.sum())} dropouts, the longest "
            f"{steps.max():.3g} s at a sample period of {sample_period(recording.t):.3g} s, "
            f"the first at t = {first:.6g} s{split}"
        )
    ]


def _clusters(recording: Recording) -> list[LieidWarning]:
    period, mean = sample_period(recording.t), 1.0 / mean_rate(recording.t)
    if mean < CLUSTERED * period:
        return []
    return [
        IrregularTimeWarning(
            f"{recording.title}: the stamps come in clusters (median step {period:.3g} s, mean "
            f"step {mean:.3g} s): these look like times of arrival; record the time of each "
            "measurement, or velocities and accelerations are wrong"
        )
    ]


def check_velocity(recording: Recording, blocks: Blocks) -> list[LieidWarning]:
    """Compare the integral of dq with q."""
    if recording.dq is None or blocks.integrated is None or len(blocks.travelled) < 8:
        return []
    title = recording.title
    way, integral = blocks.travelled, blocks.integrated
    moving = _moving_enough(way, recording)
    if not moving.any():
        return []
    gain, correlation = _gain_and_correlation(way, integral)
    for factor, meaning in UNIT_RATIOS:
        in_unit = moving & (np.abs(gain / factor - 1.0) < 0.15) & (correlation > 0.9)
        if in_unit.sum() > 0.5 * moving.sum():
            joint = int(np.argmax(in_unit))
            raise RecordingError(
                f"{title}: column dq{joint + 1}: found {gain[joint]:.3g} times the derivative of "
                f"q{joint + 1}, expected 1; this looks like {meaning}"
            )
    wrong = moving & ((correlation < 0.9) | (np.abs(np.log(np.maximum(gain, 1e-12))) > 0.22))
    if not wrong.any():
        return []
    details = ", ".join(
        f"joint {j + 1} (gain {gain[j]:.2g}, correlation {correlation[j]:.2g}"
        f"{_runs_like(way, integral, moving, j)})"
        for j in np.nonzero(wrong)[0].tolist()
    )
    return [VelocityMismatchWarning(f"{title}: dq is not the derivative of q: {details}")]


def check_still(recording: Recording, robot: Robot | None) -> list[LieidWarning]:
    """Name the joints that never move."""
    limits = np.full(recording.n, STILL)
    if robot is not None:
        limits = np.array([STILL if joint.revolute else 0.1 * STILL for joint in robot.joints])
    still = np.ptp(recording.q, axis=0) < limits
    if not still.any():
        return []
    return [
        JointStillWarning(
            f"{recording.title}: {joints_text(still)} never moved: friction and inertia of a "
            "joint at rest are not identifiable"
        )
    ]


def check_rate(recording: Recording) -> list[LieidWarning]:
    """Report motion near the Nyquist frequency."""
    band = motion_band(recording)
    if band is None or band < 0.1 * recording.rate:
        return []
    return [
        LowRateWarning(
            f"{recording.title}: {recording.rate:.3g} Hz is a low rate for motion "
            f"up to {band:.3g} Hz, expected {10.0 * band:.3g} Hz or more: accelerations are "
            "underestimated"
        )
    ]


def _moving_enough(way: Array, recording: Recording) -> Mask:
    """Return the joints whose change per block is above the resolution of q."""
    per_block = np.sqrt(np.mean(way**2, axis=0))
    distinct = [np.unique(column) for column in recording.q.T]
    quantum = np.array([np.min(np.diff(d)) if d.size > 1 else np.inf for d in distinct])
    return np.asarray((np.ptp(recording.q, axis=0) > 10.0 * STILL) & (per_block > 3.0 * quantum))


def _gain_and_correlation(way: Array, integral: Array) -> tuple[Array, Array]:
    with np.errstate(invalid="ignore", divide="ignore"):
        squares, products = np.sum(way**2, axis=0), np.sum(way * integral, axis=0)
        others = np.sum(integral**2, axis=0)
        gain = np.sqrt(others / squares)
        correlation = products / np.sqrt(squares * others)
    # a joint exactly at rest has no gain; it is not among those that move
    return np.nan_to_num(gain, posinf=0.0), np.nan_to_num(correlation)


def _runs_like(way: Array, integral: Array, moving: Mask, joint: int) -> str:
    """Return a remark on the joint whose motion this column of dq shows instead."""
    column = np.repeat(integral[:, [joint]], way.shape[1], axis=1)
    _, correlation = _gain_and_correlation(way, column)
    best = int(np.argmax(np.where(moving, np.abs(correlation), 0.0)))
    if correlation[joint] < -0.9:
        return ", sign swapped"
    if best != joint and correlation[best] > 0.95:
        return f", runs like joint {best + 1}"
    return ""
