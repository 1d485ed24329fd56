"""Options as data: the notation of one option, and the options that several commands share."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NoReturn

from lieid_casadi.cli.option_types import (
    Calibration,
    InputPath,
    OutputFile,
    OutputFolder,
    PictureFile,
    number,
    seed,
)

DEFAULT_EFFECTS = "coulomb,viscous,offset"


@dataclass(frozen=True)
class Option:
    """An option or argument of a command: its names, and the settings of argparse."""

    names: tuple[str, ...]
    settings: dict[str, Any]

    def given(self, args: argparse.Namespace) -> str | None:
        """Return the option as written if its value is not the default."""
        name = self.names[-1]
        switch = self.settings.get("action") == "store_true"
        default = False if switch else self.settings.get("default")
        value = getattr(args, name.removeprefix("--").replace("-", "_"))
        return name if value != default else None


@dataclass(frozen=True)
class Group:
    """Options under a title of their own in the help."""

    title: str
    options: tuple[Option, ...]
    about: str | None = None


@dataclass(frozen=True)
class Command:
    """A command of ``lieid``: its words in the help, its options, and the function that runs it."""

    name: str
    help: str
    description: str
    options: tuple[Option | Group, ...]
    run: Callable[[argparse.Namespace], Any]
    usage: str | None = None

    def add_to(self, commands: Any) -> None:
        """Add the parser of this command to the subparsers of ``lieid``."""
        parser = commands.add_parser(
            self.name, help=self.help, description=self.description, usage=self.usage
        )
        for item in self.options:
            if isinstance(item, Option):
                parser.add_argument(*item.names, **item.settings)
            else:
                group = parser.add_argument_group(item.title, item.about)
                for each in item.options:
                    group.add_argument(*each.names, **each.settings)
        parser.set_defaults(run=self.run)


def option(notation: str, text: str, kind: Any = None, default: Any = None, **more: Any) -> Option:
    """Return an option from its notation, such as ``-o/--output FILE`` or ``fit FIT``.

    Without a name for the value and without choices it is a switch. A default that is stated is
    appended to the text.
    """
    names, _, value = notation.partition(" ")
    settings: dict[str, Any] = {"help": text} | more
    if value:
        settings["metavar"] = value
    elif not {"choices", "metavar"} & more.keys() and names.startswith("-"):
        return Option(tuple(names.split("/")), {"action": "store_true"} | settings)
    if kind is not None:
        settings["type"] = kind
    if default is not None:
        settings["default"] = default
        if not isinstance(default, list) and default != "" and "default" not in text:
            shown = f"{default:g}" if isinstance(default, float) else str(default)
            settings["help"] += f"; default: {shown}"
    return Option(tuple(names.split("/")), settings)


def several(notation: str, text: str, kind: Any = InputPath, **more: Any) -> Option:
    """Return an option or argument with one or more values; an option is empty by default."""
    if notation.startswith("-") and "required" not in more:
        more = {"default": []} | more
    return option(notation, text, kind, **({"nargs": "+"} | more))


def removed(name: str, advice: str) -> Option:
    """Return an option that was removed: it refuses every value with advice."""

    def refuse(text: str) -> NoReturn:
        raise argparse.ArgumentTypeError(f"{text}: removed; {advice}")

    return option(f"{name} X", argparse.SUPPRESS, refuse)


# Robots, fits and recordings.

TIP = option("--tip LINK", "last link of the chain (URDF, MJCF)")
LOCK = several("--lock JOINT", "joints to lock", None)
_ROBOT = "URDF, MJCF or YAML file, or a bundled name"
ROBOT = (option("robot ROBOT", f"{_ROBOT}; the robot of a fit (JSON)", InputPath), TIP, LOCK)
ROBOT_OR_FIT = (option("robot ROBOT|FIT", f"{_ROBOT}, or a fit (JSON)", InputPath), TIP, LOCK)
TEST = "recordings to test on, which are not fitted"

TORQUE_CONSTANTS = option(
    "--torque-constants K1,…,Kn", "torque constants, N·m/A, for recordings with currents i1…in"
)
DRIVES = Group(
    "position-controlled drives",
    (
        option(
            "--stiffness K1,…,Kn",
            "N·m/rad per joint, or one number for all; unknown: torques in units of K",
        ),
        option(
            "--damping D1,…,Dn",
            "N·m·s/rad per joint, or one number for all (s if the stiffness is unknown); "
            "default: 0",
        ),
        option("--servo NAME[,…]", "preset of a servo, such as sts3215, for all or each"),
    ),
    "Torque of recordings with commanded positions qcmd1…qcmdn and without tau: "
    "K·(qcmd − q) − D·dq, limited by the robot's torque limits.",
)
DATASETS = Group(
    "LeRobot datasets",
    (
        option("--episodes A:B", "episodes A to B − 1, counted from 0; default: all"),
        option(
            "--calibration FILE|limits",
            "LeRobot's calibration file, or limits: normalised ranges end at the position limits",
            Calibration,
        ),
    ),
)
CORRECTIONS = Group(
    "what corrects a recording or the mounting",
    (
        option("--base-rpy X", "mounting of the base: roll, pitch, yaw, rad", nargs=3),
        option("--joint-order J", "the recorded joint at the place of each joint", nargs="+"),
        option("--joint-sign S", "1 or -1 per joint: direction of its axis", nargs="+"),
        option("--joint-coupling I+J", "angle I is that of a motor, plus or minus J", nargs="+"),
        option("--joint-zero X", "rad per joint, added to its angle", nargs="+"),
        option("--torque-sign S", "1 or -1 per torque of the recording", nargs="+"),
        option("--time-offset S", "time by which the torque is late, s"),
        option("--derive-velocity", "take velocities from the positions, not from the recording"),
    ),
    "`lieid check` tests what these options correct, and prints them. They are stored in a fit and "
    "used for recordings that are compared with it, unless others are given.",
)
#: What every command that reads recordings accepts, whatever it takes as torque.
READING = (
    option(
        "--units UNIT[,UNIT]",
        "units of the recordings that are not SI: deg, and ms, us or ns",
        default="",
    ),
    option(
        "--columns NAME=COLUMN,…",
        "columns of other names than those of the file format, such as t=stamp,q=pos_*,tau1=effort",
    ),
    option(
        "--inflate-limit MIB",
        "size that a compressed recording may inflate to; default: 1024",
        number,
    ),
    DATASETS,
    CORRECTIONS,
)
EFFECTS_FILE = option(
    "--effects-file F.py", "Python file that registers your own effects; it is executed", InputPath
)
THREADS = option("--threads N", "threads to use; default: 2", int)
#: What every command has that computes torques along recordings.
RECORDING = (TORQUE_CONSTANTS, DRIVES, *READING, EFFECTS_FILE, THREADS)

# Models and filters.

MOTOR_SIDE = option(
    "--motor-side",
    "torque is measured at the motors, as from their currents: adds armature to the default "
    "effects; implied by --torque-constants",
)
CUTOFF = option(
    "--cutoff HZ", "cut-off frequency of the low-pass filter; default: chosen from the data", number
)
PROCESSING = (
    CUTOFF,
    option("--average-periods", "average periodic recordings over periods"),
    option(
        "--smoothing",
        "filter; rloess smooths acceleration and torque by robust local regression before it",
        choices=["butterworth", "rloess"],
        default="butterworth",
    ),
)


def effects(default: str | None = DEFAULT_EFFECTS) -> Option:
    """Return --effects; None stands for defaults that the recordings decide."""
    stated = DEFAULT_EFFECTS if default is None else default or "none"
    text = f"effects of the model; B:2+3 is B on joints 2 and 3; default: {stated}"
    return option("--effects A,B:2+3,…", text, default=default)


# Outputs and resources.

JSON = option("--json FILE", "write the result as JSON", OutputFile)
HTML = option("--html FILE", "write a self-contained report", OutputFile)
FORCE = option("--force", "replace the files that lieid wrote into the folder; others are kept")


def output_file(value: str, text: str, **more: Any) -> Option:
    """Return -o FILE."""
    return option(f"-o/--output {value}", text, OutputFile, **more)


def output_folder(default: str | None = None) -> tuple[Option, Option]:
    """Return -o DIR and --force."""
    needed = {"required": True} if default is None else {"default": default}
    return option("-o/--output DIR", "folder to write", OutputFolder, **needed), FORCE


def plot(text: str) -> Option:
    """Return --plot FILE."""
    return option("--plot FILE", text, PictureFile)


def random_seed(text: str) -> Option:
    """Return --seed N."""
    return option("--seed N", text, seed, 0)
