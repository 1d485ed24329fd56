"""Options that state where the torque of recordings comes from, and their default effects."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from lieid_casadi.cli import output
from lieid_casadi.errors import UsageError

if TYPE_CHECKING:
    from lieid_casadi.identification import Fit
    from lieid_casadi.model import Model
    from lieid_casadi.recording import Recording
    from lieid_casadi.robot import Robot


def add_motor_side(parser: argparse.ArgumentParser) -> None:
    """Add --motor-side."""
    parser.add_argument(
        "--motor-side",
        action="store_true",
        help="torque is measured at the motors, as from their currents: adds armature to the "
        "default effects; implied by --torque-constants",
    )


def model_for(args: argparse.Namespace, robot: Robot, recordings: Sequence[Recording]) -> Model:
    """Return the model with --effects, or with the default effects for the recordings' torque.

    Rotor inertia among the default effects is reported.

    Parameters
    ----------
    args : argparse.Namespace
    robot : Robot
    recordings : sequence of Recording
        To be fitted.
    """
    from lieid_casadi.identification.default_effects import default_effects
    from lieid_casadi.model import Model

    if args.effects is not None:
        return Model(robot, args.effects)
    default = default_effects(robot, recordings, motor_side=args.motor_side)
    if default.reason:
        output.say(
            f"Effects: {', '.join(default.names)}. Rotor inertia (armature) is among them because "
            f"{default.reason}; --effects states others."
        )
    return Model(robot, default.names)


def torque_constants_of(args: argparse.Namespace, robot: Robot) -> list[float] | None:
    """Return the constants of --torque-constants or of the robot (n), N·m/A."""
    import numpy as np

    if args.torque_constants is not None:
        try:
            constants = [float(text) for text in args.torque_constants.split(",")]
        except ValueError:
            constants = []
        if not constants or not all(np.isfinite(k) and k != 0.0 for k in constants):
            raise UsageError(
                f"--torque-constants {args.torque_constants}: expected numbers K1,…,K{robot.n} "
                "other than 0, N·m/A"
            )
        if len(constants) != robot.n:
            raise UsageError(
                f"--torque-constants: {len(constants)} numbers; expected {robot.n}, one per joint"
            )
        return constants
    if np.all(np.isfinite(robot.torque_constants)):
        return [float(k) for k in robot.torque_constants]
    return None


def as_in_training(args: argparse.Namespace, fit: Fit) -> dict[str, Any]:
    """Return the options of `Recording.load` that a fit's training recordings were read with."""
    used, options = fit.provenance, dict[str, Any]()
    if args.torque_constants is None and used.torque_constants is not None:
        options["torque_constants"] = list(used.torque_constants)
    if not args.units and used.units:
        options["units"] = ",".join(used.units)
    return options
