"""Options that several commands share, and the objects made from them."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from lieid_casadi.cli import effects_file
from lieid_casadi.cli.drive_options import (
    add_dataset_options,
    add_drive_options,
    dataset_options_of,
    drives_of,
    require_drive_law,
)
from lieid_casadi.cli.option_types import InputPath, OutputFile, OutputFolder, number
from lieid_casadi.cli.torque_options import as_in_training, torque_constants_of
from lieid_casadi.errors import UsageError

if TYPE_CHECKING:
    from lieid_casadi.identification import Fit
    from lieid_casadi.model import Model
    from lieid_casadi.recording import Processing, Recording
    from lieid_casadi.robot import Robot

DEFAULT_EFFECTS = "coulomb,viscous,offset"


def add_robot(parser: argparse.ArgumentParser, *, fit: bool = False) -> None:
    """Add ROBOT, or ROBOT|FIT, with --tip and --lock."""
    parser.add_argument(
        "robot",
        type=InputPath,
        metavar="ROBOT|FIT" if fit else "ROBOT",
        help="URDF, MJCF or YAML file, or a bundled name"
        + (", or a fit (JSON)" if fit else "; the robot of a fit (JSON)"),
    )
    parser.add_argument("--tip", metavar="LINK", help="last link of the chain (URDF, MJCF)")
    parser.add_argument("--lock", nargs="+", default=[], metavar="JOINT", help="joints to lock")


def add_recording_options(parser: argparse.ArgumentParser) -> None:
    """Add what turns recordings into torques and signals."""
    parser.add_argument(
        "--torque-constants",
        metavar="K1,…,Kn",
        help="torque constants, N·m/A, for recordings with currents i1…in",
    )
    add_drive_options(parser)
    add_reading_options(parser)


def add_reading_options(parser: argparse.ArgumentParser) -> None:
    """Add --units and --inflate-limit, and options of datasets."""
    parser.add_argument(
        "--units",
        default="",
        metavar="UNIT[,UNIT]",
        help="units of the recordings that are not SI: deg, and ms, us or ns",
    )
    parser.add_argument(
        "--inflate-limit",
        type=number,
        metavar="MIB",
        help="size that a compressed recording may inflate to; default: 1024",
    )
    add_dataset_options(parser)


def add_processing(parser: argparse.ArgumentParser) -> None:
    """Add filter options."""
    parser.add_argument(
        "--cutoff",
        type=number,
        metavar="HZ",
        help="cut-off frequency of the low-pass filter; default: chosen from the data",
    )
    parser.add_argument(
        "--average-periods", action="store_true", help="average periodic recordings over periods"
    )
    parser.add_argument(
        "--smoothing",
        choices=["butterworth", "rloess"],
        default="butterworth",
        help="filter; rloess smooths acceleration and torque by robust local regression before it",
    )


def add_effects(parser: argparse.ArgumentParser, *, default: str | None = DEFAULT_EFFECTS) -> None:
    """Add --effects and --effects-file; None stands for defaults that depend on the recordings."""
    stated = DEFAULT_EFFECTS if default is None else default or "none"
    parser.add_argument(
        "--effects",
        default=default,
        metavar="A,B:2+3,…",
        help=f"effects of the model; B:2+3 is B on joints 2 and 3; default: {stated}",
    )
    effects_file.add_option(parser)


def add_outputs(parser: argparse.ArgumentParser, *, html: bool = False) -> None:
    """Add --json, and --html where there is a report."""
    parser.add_argument("--json", type=OutputFile, metavar="FILE", help="write the result as JSON")
    if html:
        parser.add_argument(
            "--html", type=OutputFile, metavar="FILE", help="write a self-contained report"
        )


def add_output_folder(parser: argparse.ArgumentParser, *, default: str | None = None) -> None:
    """Add -o DIR and --force."""
    parser.add_argument(
        "-o",
        "--output",
        type=OutputFolder,
        required=default is None,
        default=default,
        metavar="DIR",
        help="folder to write" + ("" if default is None else f"; default: {default}"),
    )
    parser.add_argument(
        "--force",
        action="store_true",
        help="replace the files that lieid wrote into the folder; others are kept",
    )


def add_threads(parser: argparse.ArgumentParser) -> None:
    """Add --threads."""
    parser.add_argument("--threads", type=int, metavar="N", help="threads to use; default: 2")


def use_threads(args: argparse.Namespace) -> None:
    """Apply --threads; it has no effect on linear algebra once NumPy is imported."""
    import os

    threads = getattr(args, "threads", None)
    if threads is None:
        return
    if threads < 1:
        raise UsageError(f"--threads {threads}: expected 1 or more")
    for name in ("LIEID_THREADS", "OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
        os.environ[name] = str(threads)


def robot_of(args: argparse.Namespace) -> Robot:
    """Return the robot that ROBOT, --tip and --lock name, with the drive laws of the options.

    A fit in place of ROBOT gives the robot that it contains.
    """
    from lieid_casadi.identification import Fit
    from lieid_casadi.robot import Robot

    if Path(args.robot).suffix.lower() == ".json":
        robot = Fit.load(args.robot).model.robot
    else:
        robot = Robot.load(args.robot, tip=args.tip, lock=args.lock)
    drives = drives_of(args, robot)
    return robot if drives is None else robot.with_drives(drives)


def model_of(args: argparse.Namespace) -> Model:
    """Return the model of the robot with --effects."""
    from lieid_casadi.model import Model

    effects_file.load(args.effects_file)
    return Model(robot_of(args), args.effects)


def recordings_of(
    paths: Sequence[str], args: argparse.Namespace, source: Robot | Fit
) -> list[Recording]:
    """Load recordings.

    Currents become torques by --torque-constants, the constants of a fit, or the robot's own.
    Without --units, those of a fit's training recordings are used.

    Parameters
    ----------
    paths : sequence of str
    args : argparse.Namespace
    source : Robot or Fit
    """
    from lieid_casadi.identification import Fit
    from lieid_casadi.recording import Recording, require_plausible_units

    robot = source.model.robot if isinstance(source, Fit) else source
    options = torque_options_of(args, robot)
    if isinstance(source, Fit):
        options |= as_in_training(args, source)
    recordings = [Recording.load(path, **options) for path in paths]
    for recording in recordings:
        require_drive_law(recording)
        require_plausible_units(recording, robot)
    return recordings


def training_of(paths: Sequence[str], args: argparse.Namespace, robot: Robot) -> list[Recording]:
    """Load the recordings that a model is fitted to."""
    from lieid_casadi.recording import Recording

    options = torque_options_of(args, robot)
    recordings = [Recording.load(path, **options) for path in paths]
    for recording in recordings:
        require_drive_law(recording)
    return recordings


def torque_options_of(args: argparse.Namespace, robot: Robot) -> dict[str, Any]:
    """Return the arguments of `Recording.load`, with the sources of torque."""
    return reading_options_of(args, robot) | {
        "torque_constants": torque_constants_of(args, robot),
        "drives": drives_of(args, robot),
    }


def reading_options_of(args: argparse.Namespace, robot: Robot) -> dict[str, Any]:
    """Return the arguments of `Recording.load` that the robot and the options give."""
    import numpy as np

    options: dict[str, Any] = {
        "n": robot.n,
        "joint_names": [joint.name for joint in robot.joints],  # bags name theirs
        "units": args.units,
        "revolute": np.array([joint.revolute for joint in robot.joints]),
        **dataset_options_of(args, robot),
    }
    if args.inflate_limit is not None:
        if not args.inflate_limit > 0.0:
            raise UsageError(f"--inflate-limit {args.inflate_limit:g}: expected MiB above 0")
        options["inflate_limit"] = int(args.inflate_limit * 2**20)
    return options


def processing_of(args: argparse.Namespace) -> Processing:
    """Return the filter options."""
    from lieid_casadi.recording import Processing

    return Processing(
        cutoff=args.cutoff, average_periods=args.average_periods, smoother=args.smoothing
    )
