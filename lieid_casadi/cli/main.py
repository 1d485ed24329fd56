"""Entry point of ``lieid``: parse, run one command, return its exit status."""

from __future__ import annotations

import argparse
import contextlib
import importlib
import io
import logging
import os
import sys
import warnings
from collections.abc import Sequence
from functools import cache
from typing import NoReturn

from lieid_casadi import __version__
from lieid_casadi.cli import inputs
from lieid_casadi.cli.options import COMMANDS, Command, check_paths, writes_to_stdout
from lieid_casadi.cli.output import Outcome, visible
from lieid_casadi.errors import LieidError, NoSolution, PremiseError

DONE, INTERNAL, BAD_INPUT, NO_SOLUTION, WRONG_PREMISE, INTERRUPTED = 0, 1, 2, 3, 4, 130
MODULES = (
    "demo", "show", "excite", "check", "identify", "predict", "compare", "friction", "diagnose",
    "extend", "discriminate", "experiment", "payload", "gains", "simulate", "sample", "export",
    "effects", "workbench", "fleet",
)  # fmt: skip


class Parser(argparse.ArgumentParser):
    """An argument parser whose errors are one line."""

    def error(self, message: str) -> NoReturn:
        """Print one line on stderr and exit with status 2."""
        self.exit(BAD_INPUT, f"{self.prog}: {visible(' '.join(message.split()))}\n")


@cache
def build_parser() -> Parser:
    """Return the parser of all commands."""
    parser = Parser(
        prog="lieid",
        description="Identify the dynamic model of a robot arm and find the effects that it lacks.",
        allow_abbrev=False,
    )
    parser.add_argument("--version", action="version", version=f"lieid {__version__}")
    parser.add_argument("--debug", action="store_true", help="show the traceback of an error")
    commands = parser.add_subparsers(dest="command", metavar="COMMAND", required=True)
    for name, command in _commands().items():
        command.add_to(name, commands)
    return parser


def _commands() -> dict[str, Command]:
    """Return the commands of all modules by their names."""
    for name in MODULES:
        importlib.import_module(f"lieid_casadi.cli.{name}")
    return COMMANDS


def main(words: Sequence[str] | None = None) -> int:
    """Run ``lieid`` and return its exit status (0, 1, 2, 3, 4 or 130)."""
    if words is None:
        _open_streams()
    try:
        given = _joined(sys.argv[1:] if words is None else words)
        args = build_parser().parse_args(given)  # imports modules, which takes a moment
    except KeyboardInterrupt:
        _say("lieid: interrupted")
        return INTERRUPTED
    _log_to_stderr()
    if words is None and not sys.warnoptions and not args.debug:
        warnings.simplefilter("ignore")  # of libraries; those of results are printed with them
    try:
        if (threads := getattr(args, "threads", None)) is not None:  # too late for a loaded NumPy
            for name in ("LIEID", "OMP_NUM", "OPENBLAS_NUM", "MKL_NUM"):
                os.environ[f"{name}_THREADS"] = str(threads)
        check_paths(args)
        with contextlib.ExitStack() as stack:
            if writes_to_stdout(args):  # tables must not get into the file
                nowhere = stack.enter_context(open(os.devnull, "w"))
                stack.enter_context(contextlib.redirect_stdout(nowhere))
            status = _run(args)
            sys.stdout.flush()
        return status
    except KeyboardInterrupt:
        _say(f"lieid {args.command}: interrupted")
        return INTERRUPTED
    except BrokenPipeError:  # the reader of the output has closed it
        _discard_unwritten()
        return DONE
    except Exception as error:  # the outermost frame: every error gets a status
        if args.debug:
            raise
        status = _status(args, error)
        if words is None:
            _discard_unwritten()
        return status


def _open_streams() -> None:
    """Replace closed standard streams by the null device; characters that one lacks by ``?``.

    A file that is opened later would otherwise get the number of a closed stream, and with it
    what libraries print.
    """
    for number, name in enumerate(("stdin", "stdout", "stderr")):
        stream = getattr(sys, name)
        if stream is None:
            handle = os.open(os.devnull, os.O_RDWR)
            if handle != number:
                os.dup2(handle, number)
            mode = "r" if name == "stdin" else "w"
            setattr(sys, name, os.fdopen(number, mode, encoding="utf-8", closefd=False))
        elif name != "stdin" and isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="replace")


def _run(args: argparse.Namespace) -> int:
    """Load the user's effects, run the command, write its files and print; return its status."""
    inputs.load_effects_file(getattr(args, "effects_file", None))
    outcome = args.run(args)
    return outcome.finish(args) if isinstance(outcome, Outcome) else int(outcome or DONE)


def _discard_unwritten() -> None:
    """Discard what stdout cannot write: Python would try again at its end and exit with 120."""
    try:
        sys.stdout.flush()
    except OSError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def _joined(words: Sequence[str]) -> list[str]:
    """Return the words with the name of a command of two words, ``fleet report``, as one."""
    first = next((k for k, word in enumerate(words) if not word.startswith("-")), len(words))
    name = " ".join(words[first : first + 2])
    if " " not in name or name not in _commands():
        return list(words)
    return [*words[:first], name, *words[first + 2 :]]


def _status(args: argparse.Namespace, error: Exception) -> int:
    """Print one line for an error and return its exit status."""
    own_code, text, status = getattr(args, "effects_file", None), str(error), BAD_INPUT
    if isinstance(error, (NoSolution, PremiseError)):
        status = NO_SOLUTION if isinstance(error, NoSolution) else WRONG_PREMISE
    elif isinstance(error, OSError):
        place = "" if error.filename is None else f"{error.filename}: "
        text = f"{place}{error.strerror or text}"
    elif own_code is not None and (line := inputs.exception_in(own_code, error)):
        text = line
    elif not isinstance(error, LieidError):
        text = f"internal error: {type(error).__name__}: {text} (--debug shows where)"
        status = INTERNAL
    _say(f"lieid {args.command}: {' '.join(text.split())}")
    return status


def _say(line: str) -> None:
    with contextlib.suppress(OSError):
        print(visible(line), file=sys.stderr)


def _log_to_stderr() -> None:
    """Print notices of the library on a terminal; elsewhere stderr stays empty."""
    if sys.stderr.isatty():
        handler = logging.StreamHandler()
        handler.setFormatter(logging.Formatter("lieid: %(message)s"))
        logging.getLogger("lieid_casadi").addHandler(handler)
    else:
        logging.getLogger("lieid_casadi").addHandler(logging.NullHandler())


if __name__ == "__main__":
    sys.exit(main())
