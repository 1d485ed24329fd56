"""Options as data: the notation that states them, their kinds, and those of several commands.

The last paragraph of a command's docstring states its options as its help shows them::

    train TRAIN …: input  recording to fit
    -o/--output fit.json: output  write the fit
    --method {ols,wls,robust} = wls  ordinary, weighted or robust least squares
    --joint J: int required  number of the joint, from 1
    --no-refit  leave out the third stage
    @RECORDING @JSON
    == title of a group of options
        what the group is for
    --starts N: int = 4  number of random starts

that is: names; the value, or ``VALUE …`` (one or more), ``[VALUE]`` (may be left out),
``[VALUE …]``, ``X Y Z`` (three), or choices in braces; its kind of `KINDS` (default: text); its
default; and two spaces before the text, which goes on in indented lines. ``repeated`` options may
be given several times. An option without value is a switch. ``@NAME`` are shared options of
`SHARED`.
"""

from __future__ import annotations

import argparse
import contextlib
import inspect
import math
import os
import re
import stat
from collections.abc import Callable
from dataclasses import dataclass
from datetime import date
from pathlib import Path
from typing import Any

from lieid_casadi.errors import UsageError

Args = argparse.Namespace  # the values of the options of one call


class InputPath(str):
    """A file or folder that a command reads; ``REC@T0:T1`` is a part of a recording."""

    @property
    def file(self) -> Path:
        """The file or folder itself."""
        path, at, _ = self.rpartition("@")
        return Path(path if at and not os.path.exists(self) else self)


class OutputFile(str):
    """A file that a command writes."""


class OutputFolder(str):
    """A folder that a command writes."""


class ResumedFolder(OutputFolder):
    """A folder in which a command goes on with what an earlier call began."""


def _checked(
    convert: Callable[[str], Any], holds: Callable[[Any], bool], message: str
) -> Callable[[str], Any]:
    """Return a type of options: a value that can be converted and for which a condition holds."""

    def kind(text: str) -> Any:
        with contextlib.suppress(ValueError):
            if holds(value := convert(text)):
                return value
        raise argparse.ArgumentTypeError(message.format(text))

    return kind


def number(text: str) -> float:
    """Return a finite number."""
    several = ", several are separated by spaces" if "," in text else ""
    value: float = _checked(float, math.isfinite, "{}: expected a number" + several)(text)
    return value


def height(text: str) -> float | None:
    """Return a height in m, or None for ``none``."""
    return None if text == "none" else number(text)


def known_mass(text: str) -> tuple[str, float]:
    """Return link and mass of ``LINK=KG``."""
    link, _, mass = text.rpartition("=")
    message = f"{text}: expected LINK=KG, a link and kg above 0"
    return link, _checked(float, lambda kg: bool(link) and 0.0 < kg < math.inf, message)(mass)


#: The kinds of values in the options of commands, by the names that they have there.
KINDS: dict[str, Callable[[str], Any]] = {
    "input": InputPath,
    "output": OutputFile,
    "folder": OutputFolder,
    "resumed": ResumedFolder,
    "int": int,
    "number": number,
    "count": _checked(int, lambda x: x >= 1, "{}: expected a whole number, 1 or more"),
    "above": _checked(float, lambda x: 0.0 < x < math.inf, "{}: expected a number above 0"),
    "height": height,
    "mass": known_mass,
    "seed": _checked(int, lambda x: x >= 0, "{}: expected a whole number, 0 or more"),
    "port": _checked(int, lambda x: 1 <= x < 65536, "{}: expected a port, 1 to 65535"),
    "night": _checked(date.fromisoformat, bool, "{}: expected a date such as 2026-11-20"),
    "part": _checked(
        float, lambda x: 0.0 <= x < 1.0, "expected a number from 0 to less than 1, found {!r}"
    ),
}


def check_paths(args: Args) -> None:
    """Refuse outputs that cannot be written or that are inputs, before any work is done."""
    from lieid_casadi.atomic_file import check_file
    from lieid_casadi.output_folder import check_folder

    values = _values(args)
    seen: set[str] = set()
    for output in (value for value in values if isinstance(value, (OutputFile, OutputFolder))):
        if isinstance(output, ResumedFolder):
            pass  # what it holds is checked when it is resumed
        elif isinstance(output, OutputFolder):
            check_folder(output, force=args.force)
        else:
            check_file(output)
        for given in (value for value in values if isinstance(value, InputPath)):
            if _overwrites(output, given.file):
                raise UsageError(f"{output}: is also an input ({given}); expected another output")
        place = os.path.realpath(output)
        if place in seen and (os.path.isfile(place) or not os.path.exists(place)):
            raise UsageError(f"{output}: is written by two options; expected different files")
        seen.add(place)


def writes_to_stdout(args: Args) -> bool:
    """Return whether a file that a command writes is standard output, as ``/dev/stdout``."""
    for value in _values(args):
        if isinstance(value, OutputFile):
            with contextlib.suppress(OSError):
                if os.path.samestat(os.stat(value), os.fstat(1)):
                    return True
    return False


def _values(args: Args) -> list[object]:
    """Return the values of all options, one by one."""
    values: list[object] = []
    for value in vars(args).values():
        values += value if isinstance(value, (list, tuple)) else (value,)
    return values


def _overwrites(output: str, given: Path) -> bool:
    """Return whether writing an output would replace an input or a file in it."""
    try:
        source, target = given.stat(), os.stat(output)
    except OSError:
        return False  # one of them does not exist
    if stat.S_ISCHR(target.st_mode) or stat.S_ISFIFO(target.st_mode):
        return False  # a terminal or a pipe may be both
    if os.path.samestat(source, target):
        return True
    inner, outer = Path(output).resolve(), given.resolve()
    if isinstance(output, OutputFolder):
        inner, outer = outer, inner
    return outer.is_dir() and inner.is_relative_to(outer)


DEFAULT_EFFECTS = "coulomb,viscous,offset"
NOTATION = re.compile(
    r"(?P<names>\S+)(?P<values>(?: \S+?)*?)(?:: (?P<kind>\w+))?(?: = (?P<default>\S+))?"
    r"(?: (?P<rule>required|repeated))?"
)
#: The commands by their names, in the order of the modules that define them.
COMMANDS: dict[str, Command] = {}


@dataclass(frozen=True)
class Command:
    """A command of ``lieid``: its line in the list of commands, and the function that runs it."""

    help: str
    run: Callable[[Args], Any]
    usage: str | None = None

    def add_to(self, name: str, commands: Any) -> None:
        """Add the parser of this command to the subparsers of ``lieid``."""
        description, _, options = inspect.getdoc(self.run).rpartition("\n\n")  # type: ignore[union-attr]
        words = " ".join(description.split())
        parser = commands.add_parser(name, help=self.help, description=words, usage=self.usage)
        _add(parser, options)
        parser.set_defaults(run=self.run)


Run = Callable[[Args], Any]


def command(name: str, help: str, *, usage: str | None = None) -> Callable[[Run], Run]:
    """Make a function a command of ``lieid``."""

    def registered(run: Run) -> Run:
        COMMANDS[name] = Command(help, run, usage)
        return run

    return registered


def given(options: str, args: Args) -> dict[str, Any]:
    """Return those options, as written, whose values are not their defaults, and the values."""
    parser = argparse.ArgumentParser()
    _add(parser, options)
    return {
        f"--{name.replace('_', '-')}": value
        for name, default in vars(parser.parse_args([])).items()
        if (value := getattr(args, name)) != default
    }


def _add(parser: Any, text: str) -> None:
    """Add the options of a text to a parser."""
    group = parser
    for entry in re.split(r"\n(?=\S)", inspect.cleandoc(text)):
        notation, *more = re.split(r" {2,}|\n\s*", entry, maxsplit=1)
        words = " ".join(" ".join(more).split())
        if entry.startswith("@"):
            for name in entry.split():
                _add(parser, SHARED[name.removeprefix("@")])
        elif entry.startswith("== "):
            group = parser.add_argument_group(notation.removeprefix("== "), words or None)
        elif (match := NOTATION.fullmatch(notation)) and words:
            group.add_argument(*match["names"].split("/"), **_settings(match, words))
        else:
            raise ValueError(f"option {notation!r}: expected NAMES VALUE: KIND = DEFAULT")


def _settings(match: re.Match[str], words: str) -> dict[str, Any]:
    """Return what argparse calls the properties of an option."""
    names, values, kind, default, rule = match.groups()
    settings: dict[str, Any] = {"help": words}
    if names.startswith("-") and not values:
        return settings | {"action": "store_true"}
    settings |= _shape(values.split())
    if kind is not None:
        settings["type"] = KINDS[kind]
    if rule == "required":
        settings["required"] = True
    elif rule == "repeated":
        settings |= {"action": "append", "default": []}
    elif names.startswith("-") and settings.get("nargs") == "+":
        settings["default"] = []
    if default is not None:
        shown = default.strip("'")
        settings["default"] = settings.get("type", str)(shown)
        if names.startswith("-") and settings.get("nargs") == "?":
            settings["const"] = settings["default"]
        if shown and "default" not in words:
            settings["help"] += f"; default: {shown}"
    return settings


def _shape(values: list[str]) -> dict[str, Any]:
    """Return how many values an option has, and how its help shows them."""
    if not values:
        return {}
    shown = " ".join(values)
    if shown.startswith("{"):
        return {"choices": shown[1:-1].split(",")}
    if shown.startswith("["):
        inner = shown[1:-1]
        return {"metavar": inner.removesuffix(" …"), "nargs": "*" if inner.endswith("…") else "?"}
    if values[-1] == "…":
        return {"metavar": values[0], "nargs": "+"}
    if len(values) > 1:
        return {"metavar": tuple(values), "nargs": len(values)}
    return {"metavar": shown}


SHARED = {
    "ROBOT": """
    robot ROBOT: input  URDF, MJCF or YAML file, or a bundled name; the robot of a fit (JSON)
    @TIP_AND_LOCK
    """,
    "ROBOT_OR_FIT": """
    robot ROBOT|FIT: input  URDF, MJCF or YAML file, or a bundled name, or a fit (JSON)
    @TIP_AND_LOCK
    """,
    "TIP_AND_LOCK": """
    --tip LINK  last link of the chain (URDF, MJCF)
    --lock JOINT …  joints to lock
    """,
    "EFFECTS_FILE": """
    --effects-file F.py: input  Python file that registers your own effects; it is executed
    """,
    "THREADS": "--threads N: count  threads to use; default: 2",
    # what every command has that computes torques along recordings
    "RECORDING": """
    --torque-constants K1,…,Kn  torque constants, N·m/A, for recordings with currents i1…in
    @DRIVES @READING @EFFECTS_FILE @THREADS
    """,
    # what every command has that reads recordings, whatever it takes as torque
    "READING": """
    --units UNIT[,UNIT] = ''  units of the recordings that are not SI: deg, and ms, us or ns
    --columns NAME=COLUMN,…  columns of other names than those of the file format, such as
        t=stamp,q=pos_*,tau1=effort
    @DATASETS @CORRECTIONS
    """,
    "DRIVES": """
    == position-controlled drives
        Torque of recordings with commanded positions qcmd1…qcmdn and without tau:
        K·(qcmd − q) − D·dq, limited by the robot's torque limits.
    --stiffness K1,…,Kn  N·m/rad per joint, or one number for all; unknown: torques in units of K;
        each: unknown on every joint, relative to joint 1 (identify)
    --damping D1,…,Dn  N·m·s/rad per joint, or one number for all (s if the stiffness is unknown);
        of a servo, its controller's gain on velocity within the limit of the duty; default: 0
    --servo NAME[,…]  preset of a servo, such as sts3215, for all or each; sts3215_gripper has half
        the torque
    """,
    "DATASETS": """
    == LeRobot datasets
    --episodes A:B  episodes A to B − 1, counted from 0; default: all
    --calibration FILE|limits: input  LeRobot's calibration file, or limits: normalised ranges
        end at the position limits
    """,
    "CORRECTIONS": """
    == what corrects a recording or the mounting
        `lieid check` tests what these options correct, and prints them. They are stored in a fit
        and used for recordings that are compared with it, unless others are given.
    --base-rpy X X X  mounting of the base: roll, pitch, yaw, rad
    --joint-order J …  the recorded joint at the place of each joint
    --joint-sign S …  1 or -1 per joint: direction of its axis
    --joint-coupling I+J …  angle I is that of a motor, plus or minus J
    --joint-zero X …  rad per joint, added to its angle
    --torque-sign S …  1 or -1 per torque of the recording
    --time-offset S  time by which the torque is late, s
    --derive-velocity  take velocities from the positions, not from the recording
    """,
    "DESPITE_CHECK": """
    --despite-check  continue although robot and recordings do not belong together
    """,
    "EFFECTS": f"""
    --effects A,B:2+3,… = {DEFAULT_EFFECTS}  effects of the model; B:2+3 is B on joints 2 and 3
    """,
    "NO_EFFECTS": """
    --effects A,B:2+3,… = ''  effects of the model; B:2+3 is B on joints 2 and 3; default: none
    """,
    # effects whose defaults the recordings decide
    "EFFECTS_BY_RECORDING": f"""
    --effects A,B:2+3,…  effects of the model; B:2+3 is B on joints 2 and 3; default:
        {DEFAULT_EFFECTS}
    --motor-side  torque is measured at the motors, as from their currents: adds armature to the
        default effects; implied by --torque-constants
    """,
    # of a search for missing effects; what has changed is judged with the model of the fit
    "ONLY_WITH_TRAIN": """
    @TIP_AND_LOCK
    --method {ols,wls,robust,feasible} = wls  ordinary, weighted or robust least squares, or
        weighted with physically consistent masses, which simulate and export need (feasible)
    @EFFECTS_BY_RECORDING @PROCESSING
    """,
    "PROCESSING": """
    --cutoff HZ: number  cut-off frequency of the low-pass filter; default: chosen from the data
    """,
    # the defaults are those of `default_limits`
    "LIMITS": """
    == limits in addition to those of position and velocity
    --velocity V …: number  velocity limits, rad/s, one or one per joint; default: the robot's
        (MuJoCo models state none)
    --acceleration A …: number  acceleration limits, rad/s², one or one per joint; default: the
        robot's, or 3
    --margin F: number = 0.8  fraction of the velocity and torque limits that is used
    --no-torque  do not check torque limits
    --cartesian-speed M/S: number = 1.5  highest speed of the tool and of the joint centres, m/s
    --floor [Z]: height = 0  height of the floor in the base frame, m, or none
    --unchecked-workspace  do not check floor, self-collision and tool speed
    --wall NX NY NZ D: number repeated  keep the arm where n·x ≤ d, base frame, m
    --workspace-box X0 Y0 Z0 X1 Y1 Z1: number repeated  keep the arm inside this box, base frame, m
    --obstacle X0 Y0 Z0 X1 Y1 Z1: number repeated  keep the arm outside this box, base frame, m
    --self-collision [M]: number = 0.02  least distance between links, m
    --capsules FILE: input  YAML file with capsules around the links; default: fitted to their
        geometry
    """,
    "JSON": "--json FILE: output  write the result as JSON",
    "HTML": "--html FILE: output  write a self-contained report",
    "FORCE": "--force  replace the files that lieid wrote into the folder; others are kept",
    "FOLDER": """
    -o/--output DIR: folder required  folder to write
    @FORCE
    """,
    "HISTORY": "history HISTORY: input  history (DuckDB)",
    "CHANGED_HISTORY": """
    history HISTORY  history (DuckDB) to change
    serial SERIAL  serial number of the arm
    --wait S: number = 0  seconds to wait for a run that has the history open
    """,
}
