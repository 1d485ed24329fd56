"""LeRobot datasets, versions 2.1 and 3.0: measured and commanded positions (extra ``[parquet]``).

``observation.state`` is the measured and ``action`` the commanded position. Each episode becomes a
segment of its own. Joints are matched by their names.
"""

from __future__ import annotations

import hashlib
import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from lieid_casadi.arrays import Array
from lieid_casadi.errors import (
    AssumedCalibrationWarning,
    LieidWarning,
    RecordingError,
    UnknownColumnWarning,
)
from lieid_casadi.messages import names_text, shortened
from lieid_casadi.recording.measurement import Measurement
from lieid_casadi.recording.readers.parquet_file import import_pyarrow, require_bounded_size
from lieid_casadi.recording.readers.registry import ReadOptions, RecordingFormat, library_errors

INFO = Path("meta") / "info.json"
STATE, ACTION = "observation.state", "action"
VERSIONS = ("v2.0", "v2.1", "v3.0")
PAUSE = 1.0  # s between episodes on the recording's clock
LARGEST_INFO = 16 << 20  # bytes
_EPISODE_FILE = re.compile(r"episode_([0-9]{1,9})\.parquet")


class _Feature(msgspec.Struct):
    """A feature; names are a list, or a list inside a mapping."""

    shape: list[int]
    names: Any = None


class _Info(msgspec.Struct):
    """What a dataset states about itself, without the features that are not read."""

    codebase_version: str
    fps: float
    features: dict[str, Any]


def read_dataset(folder: Path, options: ReadOptions) -> Measurement:
    """Read the episodes of a LeRobot dataset as one measurement with a segment per episode."""
    _, parquet = import_pyarrow(folder)
    info = _info(folder)
    names = _names(info, STATE, folder)
    joints = options.joint_names or names
    columns = _matched(names, joints, folder)
    command_columns = _matched(_names(info, ACTION, folder), joints, folder)
    frames = _frames(folder, parquet, options)
    episode = np.asarray(frames["episode_index"], dtype=np.int64)
    order = np.lexsort((frames["frame_index"], episode))
    t = _times(episode[order], np.asarray(frames["frame_index"])[order], info.fps)
    q = frames[STATE][order][:, columns]
    command = frames[ACTION][order][:, command_columns]
    motors = [names[k] for k in columns]
    (q, command), warnings = convert_positions(folder, motors, (q, command), options)
    return Measurement(
        t=t,
        q=q,
        command=command,
        pauses=tuple(t[:-1][np.diff(episode[order]) != 0].tolist()),
        name=_title(folder, options),
        source_hash=frames["hash"],
        warnings=warnings + _ignored(folder, names, columns),
    )


def _title(folder: Path, options: ReadOptions) -> str:
    """Return the name of a recording of the chosen episodes."""
    first, end = options.episodes
    if first == 0 and end is None:
        return folder.name
    return f"{folder.name} episodes {first}:{'' if end is None else end}"


def _info(folder: Path) -> _Info:
    file = folder / INFO
    if file.stat().st_size > LARGEST_INFO:
        raise RecordingError(f"{file}: larger than {LARGEST_INFO >> 20} MiB, expected a dataset")
    with library_errors(file, "the description of a LeRobot dataset"):
        info = msgspec.json.decode(file.read_bytes(), type=_Info)
    if info.codebase_version not in VERSIONS:
        raise RecordingError(
            f"{file}: found codebase_version {shortened(info.codebase_version)}, "
            f"expected {', '.join(VERSIONS)}"
        )
    if not 1.0 <= info.fps <= 1e5:
        raise RecordingError(f"{file}: found {info.fps:g} fps, expected 1 or more")
    return info


def _names(info: _Info, feature: str, folder: Path) -> tuple[str, ...]:
    """Return the names of the motors of a feature, without LeRobot's prefix and suffix."""
    where = f"{folder / INFO}: feature {feature}"
    if feature not in info.features:
        raise RecordingError(f"{where} is missing, expected it")
    with library_errors(folder / INFO, f"a dataset with names of {feature}"):
        stated = msgspec.convert(info.features[feature], _Feature)
        given = stated.names
        if isinstance(given, dict):
            given = next(iter(given.values()), None)
        names = msgspec.convert(given or [], list[str])
    if not names or stated.shape != [len(names)]:
        raise RecordingError(f"{where}: found {len(names)} names, expected one per motor")
    return tuple(name.removesuffix(".pos").removeprefix("main_") for name in names)


def _matched(names: Sequence[str], joints: Sequence[str], folder: Path) -> list[int]:
    """Return the column of each joint."""
    missing = [joint for joint in joints if joint not in names]
    if missing:
        raise RecordingError(
            f"{folder}: no motor {shortened(missing[0])} (found {names_text(list(names))}), "
            f"expected the robot's joints {names_text(list(joints))}"
        )
    return [names.index(joint) for joint in joints]


def _frames(folder: Path, parquet: Any, options: ReadOptions) -> dict[str, Any]:
    """Return the columns of the frames of the chosen episodes, and the hash of their files."""
    first, end = options.episodes
    wanted = [STATE, ACTION, "frame_index", "episode_index"]
    digest = hashlib.sha256((folder / INFO).read_bytes())
    found: dict[str, list[Any]] = {name: [] for name in wanted}
    chosen = [("episode_index", ">=", first)]
    if end is not None:
        chosen.append(("episode_index", "<", end))
    for file in sorted((folder / "data").glob("*/*.parquet")):
        own = _EPISODE_FILE.fullmatch(file.name)  # of version 2, which has a file per episode
        if own is not None and not first <= int(own[1]) < (np.inf if end is None else end):
            continue
        require_bounded_size(file)
        digest.update(file.read_bytes())
        with library_errors(file, "a data file of a LeRobot dataset"):
            table = parquet.read_table(file, columns=wanted, filters=chosen)
            for name in wanted:
                rows = table.column(name).to_pylist() if name in (STATE, ACTION) else table[name]
                found[name].append(_numbers(rows, f"{file}: column {name}"))
    if not sum(map(len, found["episode_index"])):
        stated = f"{first}:{'' if end is None else end}"
        raise RecordingError(
            f"{folder}: no frames in episodes {stated}, expected some (--episodes)"
        )
    with library_errors(folder, "a dataset with as many motors in every file"):
        made: dict[str, Any] = {name: np.concatenate(parts) for name, parts in found.items()}
    return made | {"hash": digest.hexdigest()}


def _numbers(rows: Any, where: str) -> Array:
    values = np.asarray(rows)
    if values.dtype.kind not in "iuf" and values.size:
        raise RecordingError(f"{where}: found {values.dtype}, expected numbers")
    return values


def _times(episode: Any, frame: Any, fps: float) -> Array:
    """Return times (N,), s: frames at their rate, and a pause between episodes."""
    starts = np.flatnonzero(np.diff(episode, prepend=episode[0] - 1))
    t = frame / fps
    end = -PAUSE
    for a, b in zip(starts, [*starts[1:], len(t)], strict=True):
        t[a:b] += end + PAUSE - t[a]
        end = t[b - 1]
    return np.asarray(t, dtype=np.float64)


def _ignored(
    folder: Path, names: Sequence[str], columns: Sequence[int]
) -> tuple[LieidWarning, ...]:
    unused = [name for k, name in enumerate(names) if k not in columns]
    if not unused:
        return ()
    return (
        UnknownColumnWarning(f"{folder.name}: motors of no joint ignored: {names_text(unused)}"),
    )


FORMAT = RecordingFormat(
    suffixes=(), read=read_dataset, folder=lambda folder: (folder / INFO).is_file()
)


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

    LeRobot stores each motor in per cent of its calibrated range, −100 to 100 (grippers 0 to 100),
    or, with ``use_degrees``, in degrees from the middle of that range; grippers stay in per cent.
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
    limits = options.position_limits
    limits = np.full((len(motors), 2), np.nan) if limits is None else limits
    if not np.all(np.isfinite(limits[per_cent])):
        raise RecordingError(
            f"{folder}: {names_text(needed)}: in per cent of their ranges, and the robot states no "
            "position limits; expected LeRobot's calibration (--calibration FILE)"
        )
    return limits, (
        AssumedCalibrationWarning(
            f"{folder.name}: assumed: the normalised ranges of {names_text(needed)} end at the "
            "robot's position limits. A wrong range scales angles, and a wrong middle shifts "
            "them, which changes gravity and inertia parameters; LeRobot's calibration file of "
            "this arm (--calibration FILE) replaces the assumption"
        ),
    )


def _calibrated(file: Path, motors: Sequence[str], limits: Array | None) -> Array:
    """Return the ends (n, 2), rad, from LeRobot's calibration file; a gripper's lower is closed."""
    if not file.is_file():
        raise RecordingError(f"{file}: no such file, expected LeRobot's calibration as JSON")
    if file.stat().st_size > LARGEST_FILE:
        raise RecordingError(f"{file}: larger than 1 MiB, expected LeRobot's calibration as JSON")
    with library_errors(file, "LeRobot's calibration as JSON"):
        stated = msgspec.json.decode(file.read_bytes(), type=dict[str, _Motor])
    missing = [motor for motor in motors if motor not in stated]
    if missing:
        raise RecordingError(
            f"{file}: no motor {shortened(missing[0])} (found {names_text(list(stated))}), "
            f"expected {names_text(list(motors))}"
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
