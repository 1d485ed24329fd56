"""``lieid check ROBOT|FIT REC…``, and the same test at the start of other commands."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import lieid_casadi as lieid
from lieid_casadi.cli import inputs, output
from lieid_casadi.cli.options import Args, command
from lieid_casadi.errors import PremiseError, warning_list
from lieid_casadi.tables import Table

WRONG = 4  # exit status


@command("check", "whether robot and recording belong together")
def run(args: Args) -> output.Outcome:
    """Test what identification rests on, before any physics is inferred.

    That is: mounting, order, signs and zeros of joints, units, the meaning of the torque signal,
    timing, damaged samples. Exit status 4 if something is certainly wrong.

    @ROBOT_OR_FIT
    recordings REC …: input  recordings of one arm
    --test T …: input  recordings to test a fit on: whether they are another motion
    @RECORDING @JSON @HTML
    """
    from lieid_casadi.recording import require_plausible_units
    from lieid_casadi.report import premises_report

    source: lieid.Robot | lieid.Fit = (
        lieid.Fit.load(args.robot) if inputs.is_fit(args) else inputs.robot_of(args)
    )
    robot = source.model.robot if isinstance(source, lieid.Fit) else source
    recordings = inputs.recordings_of(args.recordings, args, source, any_unit=True)
    test = inputs.recordings_of(args.test, args, source)
    with output.progress("check") as report:
        found = lieid.check(source, recordings, test=test, progress=report)
    if not {"time_unit", "position_unit"} & {finding.premise for finding in found.findings}:
        for recording in recordings:
            require_plausible_units(recording, robot)
    said = {finding.sentence for finding in found.findings}
    every = (w for r in (*recordings, *test) for w in r.warnings)
    warnings = [w for w in every if f"{w}." not in said]
    reasons = dict.fromkeys(why for _, why in found.not_checkable)
    alike = ((why, [p for p, own in found.not_checkable if own == why]) for why in reasons)
    unchecked = [f"Not checked: {', '.join(premises)} ({why})." for why, premises in alike]
    status = WRONG if found.verdict == "wrong" else 0
    return output.Outcome(
        (*shown(found), *unchecked, *warnings),
        json=found.to_dict() | {"warnings": warning_list(warnings)},
        html=lambda: premises_report(robot, found),
        status=status,
    )


def premises_of(
    args: Args,
    source: lieid.Robot | lieid.Fit,
    recordings: Sequence[lieid.Recording],
    test: Sequence[lieid.Recording] = (),
    *,
    loaded: bool = False,
) -> list[dict[str, Any]]:
    """Check the premises and print what is wrong; return the findings for JSON.

    An arm that carries a payload resembles another arm: of one that is ``loaded`` this is no doubt.
    """
    from lieid_casadi.premises import check_where_possible

    with output.progress("check") as report:
        found = check_where_possible(source, recordings, test=test, progress=report)
    if loaded:
        kept = [f for f in found.findings if f.certain or f.premise != "robot_mismatch"]
        found = replace(found, findings=tuple(kept))
    if found.findings:
        output.show(*shown(found))
    if found.refusal and not args.despite_check:
        raise PremiseError(f"{found.refusal} Correct it, or continue with --despite-check")
    return [finding.to_dict() for finding in found.findings]


def shown(found: lieid.PremiseCheck) -> tuple[str | Table, ...]:
    """Return the verdict, the findings, and the errors without and with each correction."""
    findings = (f"  {'!!' if f.certain else '!'} {f.sentence}" for f in found.findings)
    return (found.sentence, *findings, found.table)
