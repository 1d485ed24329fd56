"""Units of LeRobot datasets: normalised ranges, degrees, and LeRobot's calibration files."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import msgspec
import numpy as np

from lieid_casadi.errors import AssumedCalibrationWarning, LieidWarning, RecordingError
from lieid_casadi.recording.arrays import Array
from lieid_casadi.recording.readers.columns import listed, shorten
from lieid_casadi.recording.readers.registry import ReadOptions, library_errors

COUNTS = 4096  # of the encoder per turn
#: Normalised ranges: of grippers, and of all other motors.
GRIPPER_RANGE, RANGE = (0.0, 100.0), (-100.0, 100.0)
BEYOND = 105.0  # no normalised value is larger
LARGEST_FILE = 1 << 20  # bytes


class _Motor(msgspec.Struct):
    """A motor in LeRobot's calibration file; ends of its range in encoder counts."""

    range_min: float
    range_max: float
    drive_mode: int = 0


def convert_positions(
    folder: Path, motors: Sequence[str], positions: tuple[Array, Array], options: ReadOptions
) -> tuple[tuple[Array, Array], tuple[LieidWarning, ...]]:
    """Return measured and commanded positions in rad (in degrees where those are stated).

    LeRobot stores each motor in per cent of its calibrated range, −100 to 100 (grippers 0 to
    100), or, with ``use_degrees``, in degrees from the middle of that range; grippers stay in per
    cent. The zero of a joint is the middle of its range.

    Parameters
    ----------
    folder
        The dataset, for messages.
    motors
        (n) names.
    positions
        Measured and commanded positions (N, n) as stored.
    options
        ``calibration``, ``position_limits`` and ``degrees``.

    Raises
    ------
    RecordingError
        Neither degrees nor a calibration is stated, or the calibration lacks a motor.
    """
    measured, command = (np.asarray(x, dtype=np.float64) for x in positions)
    per_cent = np.array(["gripper" in motor or not options.degrees for motor in motors])
    if not per_cent.any():
        return (measured, command), ()
    if options.calibration is None and not options.degrees:
        raise _unstated(folder, motors, measured)
    warnings: tuple[LieidWarning, ...] = ()
    if options.calibration is None or options.calibration == "limits":
        ends, warnings = _limits(folder, motors, per_cent, options)
    else:
        ends = _calibrated(Path(options.calibration), motors, options.position_limits)
    low = np.array([GRIPPER_RANGE[0] if "gripper" in motor else RANGE[0] for motor in motors])
    share = 1.0 / (100.0 - low)
    unit = 180.0 / np.pi if options.degrees else 1.0  # the caller converts all joints

    def converted(x: Array) -> Array:
        angle = unit * (ends[:, 0] + (x - low) * share * (ends[:, 1] - ends[:, 0]))
        return np.where(per_cent, angle, x)

    return (converted(measured), converted(command)), warnings


def _unstated(folder: Path, motors: Sequence[str], measured: Array) -> RecordingError:
    largest = np.max(np.abs(measured), axis=0, initial=0.0)
    joint = int(np.argmax(largest))
    if largest[joint] > BEYOND:
        return RecordingError(
            f"{folder}: motor {motors[joint]} reaches {largest[joint]:.4g}, which is degrees; "
            "expected --units deg (units='deg' in Python)"
        )
    return RecordingError(
        f"{folder}: the unit of the positions is not stated (values up to {largest[joint]:.4g}); "
        "expected --units deg (LeRobot's use_degrees), --calibration FILE (LeRobot's calibration "
        "of this arm) or --calibration limits (normalised range = limits of the robot's joints)"
    )


def _limits(
    folder: Path, motors: Sequence[str], per_cent: Array, options: ReadOptions
) -> tuple[Array, tuple[LieidWarning, ...]]:
    """Return the ends (n, 2), rad, at the joints' limits, and a warning that this is assumed."""
    needed = [motor for motor, used in zip(motors, per_cent, strict=True) if used]
    limits = np.array(options.position_limits or np.full((len(motors), 2), np.nan))
    if not np.all(np.isfinite(limits[per_cent])):
        raise RecordingError(
            f"{folder}: {listed(needed)}: in per cent of their ranges, and the robot states no "
            "position limits; expected LeRobot's calibration (--calibration FILE)"
        )
    return limits, (
        AssumedCalibrationWarning(
            f"{folder.name}: assumed: the normalised ranges of {listed(needed)} end at the robot's "
            "position limits. A wrong range scales angles, and a wrong middle shifts them, which "
            "changes gravity and inertia parameters; LeRobot's calibration file of this arm "
            "(--calibration FILE) replaces the assumption"
        ),
    )


def _calibrated(
    file: Path, motors: Sequence[str], limits: tuple[tuple[float, float], ...] | None
) -> Array:
    """Return the ends (n, 2), rad, from LeRobot's calibration file.

    The closed end of a gripper is at its lower limit.
    """
    if not file.is_file():
        raise RecordingError(f"{file}: no such file, expected LeRobot's calibration as JSON")
    if file.stat().st_size > LARGEST_FILE:
        raise RecordingError(f"{file}: larger than 1 MiB, expected LeRobot's calibration as JSON")
    with library_errors(file, "LeRobot's calibration as JSON"):
        stated = msgspec.json.decode(file.read_bytes(), type=dict[str, _Motor])
    missing = [motor for motor in motors if motor not in stated]
    if missing:
        raise RecordingError(
            f"{file}: no motor {shorten(missing[0])} (found {listed(list(stated))}), "
            f"expected {listed(list(motors))}"
        )
    ends = []
    for joint, motor in enumerate(motors):
        own = stated[motor]
        half = 0.5 * (own.range_max - own.range_min) * 2.0 * np.pi / COUNTS
        if not 0.0 < half <= np.pi:
            raise RecordingError(
                f"{file}: motor {motor}: found a range of {own.range_min:g} to {own.range_max:g} "
                f"counts, expected range_min < range_max within one turn ({COUNTS} counts)"
            )
        low = -half
        if "gripper" in motor:
            low = 0.0 if limits is None or np.isnan(limits[joint][0]) else limits[joint][0]
        high = low + 2.0 * half
        ends.append((high, low) if own.drive_mode else (low, high))
    return np.array(ends)
