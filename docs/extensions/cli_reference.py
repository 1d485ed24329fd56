"""Write the reference of the command line from its parser."""

import argparse
from pathlib import Path

from lieid_casadi.cli.main import build_parser

INTRODUCTION = """\
Command line
============

This page is generated from the parser of ``lieid``. Joints are numbered from 1. Tables go to
stdout; progress and notices go to stderr, and only if it is a terminal.

.. list-table:: Exit status
   :header-rows: 1

   * - status
     - meaning
   * - 0
     - done
   * - 2
     - bad input or usage: one line on stderr, and nothing is written
   * - 3
     - no solution (infeasible or not converged), with the reason and what to relax
   * - 4
     - robot and recording do not belong together (``--despite-check`` continues)
   * - 5, 6, 7
     - ``lieid fleet --exit-code``: a new alarm, arms that have not recorded, both
   * - 130
     - interrupted by Ctrl-C
   * - 1
     - internal error (``--debug`` shows the traceback)

"""


def subparsers(parser):
    """Return the parsers of the commands by name, and the one-line help of each."""
    for action in parser._actions:
        if isinstance(action, argparse._SubParsersAction):
            helps = {choice.dest: choice.help for choice in action._choices_actions}
            return action.choices, helps
    return {}, {}


def clean(text):
    """Return text with the characters escaped that are markup in reStructuredText."""
    for character in "\\*`|_":
        text = text.replace(character, "\\" + character)
    return text


def signature(action, formatter):
    """Return an option or argument as written in a command."""
    if not action.option_strings:
        return formatter._format_args(action, action.metavar or action.dest)
    if action.nargs == 0:
        return ", ".join(action.option_strings)
    values = formatter._format_args(action, action.metavar or action.dest.upper())
    return ", ".join(f"{option} {values}" for option in action.option_strings)


def section(name, parser, text):
    """Return the section of one command."""
    title = f"lieid {name}"
    usage = parser.format_usage().removeprefix("usage: ").rstrip()
    lines = [title, "-" * len(title), "", f".. program:: {title}", ""]
    lines += [clean((parser.description or text or "").strip()), ""]
    lines += ["::", "", *(f"   {line}" for line in usage.splitlines()), ""]
    formatter = parser._get_formatter()
    for action in parser._actions:
        if isinstance(action, argparse._HelpAction) or action.help == argparse.SUPPRESS:
            continue
        help_text = formatter._expand_help(action) if action.help else ""
        lines += [f".. option:: {signature(action, formatter)}", ""]
        lines += [f"   {clean(help_text)}", ""] if help_text else []
    if parser.epilog:
        lines += ["::", "", *(f"   {line}" for line in parser.epilog.splitlines()), ""]
    return "\n".join(lines)


def write(app):
    """Write reference/cli.rst."""
    commands, helps = subparsers(build_parser())
    sections = [section(name, parser, helps.get(name)) for name, parser in commands.items()]
    text = INTRODUCTION + "\n".join(sections)
    Path(app.srcdir, "reference", "cli.rst").write_text(text, "utf-8")


def setup(app):
    app.connect("builder-inited", write)
    return {"parallel_read_safe": True}
