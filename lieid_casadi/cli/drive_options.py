"""Options of recordings of position-controlled arms: drive laws, and LeRobot datasets."""

from __future__ import annotations

import argparse
import math
import re
from typing import TYPE_CHECKING, Any

from lieid_casadi.cli.option_types import InputPath
from lieid_casadi.errors import UsageError

if TYPE_CHECKING:
    from lieid_casadi.recording import Recording
    from lieid_casadi.robot import Drive, Robot


def add_drive_options(parser: argparse.ArgumentParser) -> None:
    """Add the control law of recordings with commanded positions."""
    group = parser.add_argument_group(
        "position-controlled drives",
        "Torque of recordings with commanded positions qcmd1…qcmdn and without tau: "
        "K·(qcmd − q) − D·dq, limited by the robot's torque limits.",
    )
    group.add_argument(
        "--stiffness",
        metavar="K1,…,Kn",
        help="N·m/rad per joint, or one number for all; unknown: torques in units of K",
    )
    group.add_argument(
        "--damping",
        metavar="D1,…,Dn",
        help="N·m·s/rad per joint, or one number for all (s if the stiffness is unknown); "
        "default: 0",
    )
    group.add_argument(
        "--servo", metavar="NAME[,…]", help="preset of a servo, such as sts3215, for all or each"
    )


def add_dataset_options(parser: argparse.ArgumentParser) -> None:
    """Add the options of LeRobot datasets."""
    group = parser.add_argument_group("LeRobot datasets")
    group.add_argument(
        "--episodes", metavar="A:B", help="episodes A to B − 1, counted from 0; default: all"
    )
    group.add_argument(
        "--calibration",
        type=Calibration,
        metavar="FILE|limits",
        help="LeRobot's calibration file, or limits: normalised ranges end at the position limits",
    )


def known_mass(text: str) -> tuple[str, float]:
    """Return link and mass of ``LINK=KG``."""
    link, equals, mass = text.rpartition("=")
    try:
        value = float(mass)
    except ValueError:
        value = math.nan
    if not (equals and link and 0.0 < value < math.inf):
        raise argparse.ArgumentTypeError(f"{text}: expected LINK=KG, a link and kg above 0")
    return link, value


class Calibration(InputPath):
    """A calibration file, or the word ``limits``."""


def drives_of(args: argparse.Namespace, robot: Robot) -> tuple[Drive, ...] | None:
    """Return the control laws that the options state, else those of the robot.

    Raises
    ------
    UsageError
        Contradictory options, or not one number per joint.
    """
    from lieid_casadi.robot import Drive, servo_drive

    stiffness, damping, servo = (getattr(args, x, None) for x in ("stiffness", "damping", "servo"))
    if servo is not None:
        if stiffness is not None or damping is not None:
            raise UsageError("--servo: states stiffness and damping itself; expected one of them")
        names = servo.split(",")
        names = names * robot.n if len(names) == 1 else names
        if len(names) != robot.n:
            raise UsageError(f"--servo: {len(names)} names; expected 1 or {robot.n}, one per joint")
        return robot.with_drives([servo_drive(name.strip()) for name in names]).drives
    if stiffness is None:
        if damping is not None:
            raise UsageError("--damping: needs --stiffness K1,…,Kn or --stiffness unknown")
        return robot.drives
    damping_values = _numbers("--damping", damping or "0", robot.n, least=0.0)
    if stiffness == "unknown":
        laws = [Drive(stiffness=1.0, damping=d, relative=True) for d in damping_values]
    else:
        values = _numbers("--stiffness", stiffness, robot.n, least=math.ulp(0.0))
        pairs = zip(values, damping_values, strict=True)
        laws = [Drive(stiffness=k, damping=d) for k, d in pairs]
    return robot.with_drives(laws).drives


def _numbers(option: str, text: str, n: int, *, least: float) -> list[float]:
    """Return one number per joint."""
    try:
        values = [float(part) for part in text.split(",")]
    except ValueError:
        values = []
    if not values or not all(math.isfinite(x) and x >= least for x in values):
        kind = "0 or more" if least == 0.0 else "above 0, or unknown"
        raise UsageError(f"{option} {text}: expected one number or {n} numbers {kind}")
    if len(values) == 1:
        return values * n
    if len(values) != n:
        raise UsageError(f"{option}: {len(values)} numbers; expected 1 or {n}, one per joint")
    return values


def dataset_options_of(args: argparse.Namespace, robot: Robot) -> dict[str, Any]:
    """Return the arguments of `Recording.load` that concern datasets.

    Raises
    ------
    UsageError
        Episodes that are no range.
    """
    import numpy as np

    options: dict[str, Any] = {
        "position_limits": np.column_stack(
            [robot.limit("position_lower"), robot.limit("position_upper")]
        )
    }
    if getattr(args, "episodes", None) is not None:
        match = re.fullmatch(r"([0-9]{0,9}):([0-9]{0,9})", args.episodes)
        first, end = (match[1], match[2]) if match else ("", "0")
        options["episodes"] = (int(first or 0), int(end) if end else None)
        if options["episodes"][1] is not None and options["episodes"][0] >= int(end):
            raise UsageError(
                f"--episodes {args.episodes}: expected A:B with A < B, episodes A to B − 1"
            )
    if getattr(args, "calibration", None) is not None:
        options["calibration"] = str(args.calibration)
    return options


def require_drive_law(recording: Recording) -> None:
    """Refuse a recording of commanded positions without a drive law.

    Raises
    ------
    UsageError
        Names the options that state one.
    """
    if recording.tau is None and recording.command is not None:
        raise UsageError(
            f"{recording.title}: commanded positions qcmd1…qcmd{recording.n} without torque and "
            "without a drive law; expected --stiffness K1,…,Kn, --servo NAME, --stiffness unknown, "
            "or drive: in the robot's YAML file"
        )
