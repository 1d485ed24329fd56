"""What the options of a command name: robot, model, fit, recordings, limits, own effects."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import lieid_casadi as lieid
from lieid_casadi.cli import output
from lieid_casadi.cli.options import Args, given
from lieid_casadi.errors import UsageError

if TYPE_CHECKING:
    from lieid_casadi.excitation.limits import Limit
    from lieid_casadi.premises import Correction

Value = TypeVar("Value")


def load_effects_file(path: str | None) -> None:
    """Run the user's own Python file, which registers effects."""
    if path is None:
        return
    import runpy

    if not Path(path).is_file():
        raise UsageError(f"{path}: no such file; --effects-file expects your own Python file")
    try:
        runpy.run_path(path)
    except KeyboardInterrupt:
        raise
    except BaseException as error:  # SystemExit too, and what others derive from it
        raise UsageError(exception_in(path, error) or f"{path}: {error}") from error


def exception_in(path: str, error: BaseException) -> str | None:
    """Return text that names the line of a file where an exception was raised, if it was there."""
    import traceback

    lines = [
        frame.lineno
        for frame in traceback.extract_tb(error.__traceback__)
        if frame.filename == path
    ]
    if isinstance(error, SyntaxError) and error.filename == path:
        lines.append(error.lineno)
    if not lines:
        return None
    return f"{path}, line {lines[-1]}: {type(error).__name__}: {error}"


def is_fit(args: Args) -> bool:
    """Whether ROBOT|FIT is a fit."""
    return Path(args.robot).suffix.lower() == ".json"


def robot_of(args: Args) -> lieid.Robot:
    """Return the robot that ROBOT, --tip and --lock name, with the drive laws of the options."""
    if is_fit(args):
        robot = lieid.Fit.load(args.robot).model.robot
    else:
        robot = lieid.Robot.load(args.robot, tip=args.tip, lock=args.lock)
    robot = correction_of(args, robot.n).of_robot(robot)
    drives = drives_of(args, robot)
    return _limited(args, robot if drives is None else robot.with_drives(drives))


def _limited(args: Args, robot: lieid.Robot) -> lieid.Robot:
    """Return the robot with the velocity limits of --velocity, of commands that have it."""
    velocity = getattr(args, "velocity", None)
    return robot.with_velocity_limits(velocity) if velocity else robot


def fit_of(args: Args, path: str) -> lieid.Fit:
    """Return a fit, whose robot has the velocity limits of --velocity."""
    fit = lieid.Fit.load(path)
    own = fit.model
    if (robot := _limited(args, own.robot)) is own.robot:
        return fit
    limited = lieid.Model.of_placements(robot, own.placements, library=own.library)
    return replace(fit, model=limited)


def correction_of(args: Args, n: int, source: lieid.Robot | lieid.Fit | None = None) -> Correction:
    """Return what the options correct; without any, what a fit's recordings were corrected by."""
    from lieid_casadi.premises.correction import OPTIONS, correction_of

    texts = []
    for name in OPTIONS:
        value = getattr(args, name.removeprefix("--").replace("-", "_"), None)
        if value:
            values = [] if value is True else [value] if isinstance(value, str) else value
            texts.append(" ".join([name, *values]))
    if isinstance(source, lieid.Fit):
        if getattr(args, "base_rpy", None) and not getattr(args, "train", None):
            raise UsageError("--base-rpy: the mounting is that of the fit; expected a ROBOT")
        texts = texts or list(source.provenance.corrections)
    return correction_of(texts, n)


def model_of(args: Args) -> lieid.Model:
    """Return the model of the robot with --effects."""
    return lieid.Model(robot_of(args), args.effects)


def model_for(args: Args, robot: lieid.Robot, recordings: Sequence[lieid.Recording]) -> lieid.Model:
    """Return the model with --effects, or with the default effects for the recordings' torque."""
    from lieid_casadi.identification.identify import default_effects

    if args.effects is not None:
        return lieid.Model(robot, args.effects)
    default = default_effects(robot, recordings, motor_side=args.motor_side)
    if default.reason:
        delayed = " with the delay of the commands" if "command_delay" in default.names else ""
        output.show(
            f"Effects: {', '.join(default.names)}. Rotor inertia (armature){delayed} is among them "
            f"because {default.reason}; --effects states others."
        )
    return lieid.Model(robot, default.names)


def fit_and_recordings(
    args: Args, paths: Sequence[str] | None = None
) -> tuple[lieid.Fit, list[lieid.Recording]]:
    """Return FIT and the recordings REC…, or those of other paths."""
    fit = lieid.Fit.load(args.fit)
    return fit, recordings_of(args.recordings if paths is None else paths, args, fit)


def recordings_of(
    paths: Sequence[str], args: Args, source: lieid.Robot | lieid.Fit, *, any_unit: bool = False
) -> list[lieid.Recording]:
    """Load recordings; other units than SI are refused unless ``any_unit``.

    Currents become torques by --torque-constants, the constants of a fit, or the robot's own.
    Without --units and --columns, those of a fit's training recordings are used.
    """
    from lieid_casadi.premises.correction import load_by_columns
    from lieid_casadi.recording import require_plausible_units

    robot = source.model.robot if isinstance(source, lieid.Fit) else source
    options = _reading_options(args, robot) | _torque_options(args, robot)
    columns: tuple[str, ...] = ()
    if isinstance(source, lieid.Fit):
        options |= _as_in_training(args, source)
        columns = () if args.columns else source.provenance.columns
    correction = correction_of(args, robot.n, source)
    read = (load_by_columns(path, columns, options) for path in paths)
    recordings = [correction.of_recording(recording) for recording in read]
    for recording in recordings:
        _require_drive_law(recording)
        if not any_unit:
            require_plausible_units(recording, robot)
    return recordings


def currents_of(paths: Sequence[str], args: Args, robot: lieid.Robot) -> list[lieid.Recording]:
    """Load recordings whose currents stay currents."""
    correction = correction_of(args, robot.n)
    options = _reading_options(args, robot)
    return [correction.of_recording(lieid.Recording.load(path, **options)) for path in paths]


def drives_of(args: Args, robot: lieid.Robot) -> tuple[lieid.Drive, ...] | None:
    """Return the control laws that the options state, else those of the robot."""
    stiffness, damping, servo = (getattr(args, x, None) for x in ("stiffness", "damping", "servo"))
    if stiffness is None and servo is None:
        if damping is not None:
            raise UsageError("--damping: needs --stiffness K1,…,Kn or unknown, or --servo NAME")
        return robot.drives
    gains = _numbers("--damping", damping or "0", robot.n, "0 or more", lambda d: d >= 0.0)
    if servo is not None:
        if stiffness is not None:
            raise UsageError("--servo: states the stiffness itself; expected one of them")
        names = _per_joint("--servo", servo.split(","), robot.n, "names")
        pairs = zip(names, gains, strict=True)
        return robot.with_drives(
            [lieid.servo_drive(x.strip(), derivative=d) for x, d in pairs]
        ).drives
    if stiffness == "each" and not hasattr(args, "known_mass"):
        raise UsageError(
            "--stiffness each: is for lieid identify, whose fit contains the stiffnesses found; "
            "expected numbers, or unknown"
        )
    if stiffness in ("unknown", "each"):
        laws = [lieid.Drive(stiffness=1.0, damping=d, relative=True) for d in gains]
    else:
        kind = "above 0, or unknown"
        values = _numbers("--stiffness", str(stiffness), robot.n, kind, lambda k: k > 0.0)
        laws = [lieid.Drive(stiffness=k, damping=d) for k, d in zip(values, gains, strict=True)]
    return robot.with_drives(laws).drives


def _numbers(
    option: str, text: str, n: int, kind: str, holds: Callable[[float], bool]
) -> list[float]:
    """Return finite numbers for which a condition holds, one per joint."""
    try:
        values = [float(part) for part in text.split(",")]
    except ValueError:
        values = []
    if not values or not all(math.isfinite(x) and holds(x) for x in values):
        raise UsageError(f"{option} {text}: expected one number or {n} numbers {kind}")
    return _per_joint(option, values, n, "numbers")


def _per_joint(option: str, values: list[Value], n: int, what: str) -> list[Value]:
    """Return one value per joint; one that is given is that of all."""
    if len(values) not in (1, n):
        raise UsageError(f"{option}: {len(values)} {what}; expected 1 or {n}, one per joint")
    return values * n if len(values) == 1 else values


def _torque_options(args: Args, robot: lieid.Robot) -> dict[str, Any]:
    """Return the arguments of `Recording.load` that state the source of torque."""
    constants = None
    if args.torque_constants is not None:
        kind = "other than 0, N·m/A"
        option, text = "--torque-constants", args.torque_constants
        constants = _numbers(option, text, robot.n, kind, lambda k: k != 0.0)
        if "," not in text and robot.n > 1:
            raise UsageError(f"{option}: 1 number; expected {robot.n}, one per joint")
    elif all(map(math.isfinite, robot.torque_constants)):
        constants = [float(k) for k in robot.torque_constants]
    return {"torque_constants": constants, "drives": drives_of(args, robot)}


def _as_in_training(args: Args, fit: lieid.Fit) -> dict[str, Any]:
    """Return the arguments of `Recording.load` with which a fit's recordings were read."""
    used, options = fit.provenance, dict[str, Any]()
    if args.torque_constants is None and used.torque_constants is not None:
        options["torque_constants"] = list(used.torque_constants)
    if not args.units and used.units:
        options["units"] = ",".join(used.units)
    return options


def _reading_options(args: Args, robot: lieid.Robot) -> dict[str, Any]:
    """Return the arguments of `Recording.load` that do not concern torque."""
    import numpy as np

    limits = [robot.limit("position_lower"), robot.limit("position_upper")]
    options: dict[str, Any] = {
        "n": robot.n,
        "joint_names": [joint.name for joint in robot.joints],  # bags name theirs
        "units": args.units,
        "columns": args.columns,
        "revolute": np.array([joint.revolute for joint in robot.joints]),
        "position_limits": np.column_stack(limits),
    }
    if args.episodes is not None:
        options["episodes"] = _episodes(args.episodes)
    if args.calibration is not None:
        options["calibration"] = str(args.calibration)
    return options


def _episodes(text: str) -> tuple[int, int | None]:
    match = re.fullmatch(r"([0-9]{0,9}):([0-9]{0,9})", text)
    first, end = (match[1], match[2]) if match else ("", "0")
    if end and int(first or 0) >= int(end):
        raise UsageError(f"--episodes {text}: expected A:B with A < B, episodes A to B − 1")
    return int(first or 0), int(end) if end else None


def _require_drive_law(recording: lieid.Recording) -> None:
    """Refuse a recording of commanded positions without a drive law."""
    if recording.tau is None and recording.command is not None:
        raise UsageError(
            f"{recording.title}: commanded positions qcmd1…qcmd{recording.n} without torque and "
            "without a drive law; expected --stiffness K1,…,Kn, --servo NAME, --stiffness unknown, "
            "or drive: in the robot's YAML file"
        )


def limits_of(args: Args, robot: lieid.Robot) -> list[Limit]:
    """Return the default limits with the changes that the options specify."""
    from lieid_casadi.excitation import capsules_of, load_capsules

    workspace = not args.unchecked_workspace
    links: Any = ()
    if args.capsules is not None:
        links = load_capsules(args.capsules, robot)
    elif workspace or args.wall or args.workspace_box or args.obstacle:
        links = capsules_of(robot)
    defaults = lieid.default_limits(
        robot,
        margin=args.margin,
        capsules=links,
        floor_height=args.floor if workspace else None,
        cartesian_speed=args.cartesian_speed if workspace else None,
        clearance=args.self_collision if workspace else None,
    )
    limits = [x for x in defaults if not (args.no_torque and isinstance(x, lieid.Torque))]
    limits += [lieid.Wall((x, y, z), d, capsules=links) for x, y, z, d in args.wall]
    for corners in args.workspace_box:
        limits += lieid.workspace_box(corners[:3], corners[3:], capsules=links)
    limits += [lieid.Obstacle(tuple(c[:3]), tuple(c[3:]), capsules=links) for c in args.obstacle]
    return limits


def arm_of(args: Args) -> tuple[lieid.Model | lieid.Fit, lieid.Robot]:
    """Return the fit that ROBOT|FIT names, or the model of a robot with --effects; its robot."""
    if not is_fit(args):
        model = model_of(args)
        return model, model.robot
    if names := given("@EFFECTS @TIP_AND_LOCK", args):
        raise UsageError(f"{next(iter(names))}: a fit ({args.robot}) has its own robot and effects")
    fit = fit_of(args, args.robot)
    return fit, fit.model.robot
