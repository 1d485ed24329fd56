"""``lieid payload FIT REC…``: identify the payload at the tool."""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING, Any

from lieid_casadi.cli import output, shared_options
from lieid_casadi.cli.option_types import InputPath, PictureFile, number

if TYPE_CHECKING:
    from lieid_casadi.payload import PayloadEstimate


def add_parser(commands: Any) -> None:
    """Add the command."""
    parser = commands.add_parser("payload", help="mass, centre of mass and inertia of the payload")
    parser.add_argument("fit", type=InputPath, metavar="FIT", help="made without the payload")
    parser.add_argument(
        "recordings",
        nargs="+",
        type=InputPath,
        metavar="REC",
        help="recordings measured with the payload",
    )
    parser.add_argument(
        "--refit-friction",
        action="store_true",
        help="fit Coulomb friction, viscous friction and offsets again, which change with "
        "temperature",
    )
    parser.add_argument(
        "--cutoff",
        type=number,
        metavar="HZ",
        help="cut-off frequency of the low-pass filter; default: that of the fit",
    )
    parser.add_argument(
        "--plot", type=PictureFile, metavar="FILE", help="draw the errors before and after"
    )
    shared_options.add_effects_file(parser)
    shared_options.add_recording_options(parser)
    shared_options.add_outputs(parser, html=True)
    shared_options.add_threads(parser)
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> None:
    """Identify, print and write."""
    from lieid_casadi.identification import Fit
    from lieid_casadi.payload import identify_payload
    from lieid_casadi.report import payload_report

    shared_options.load_effects_file(args.effects_file)
    fit = Fit.load(args.fit)
    recordings = shared_options.recordings_of(args.recordings, args, fit.model.robot)
    with output.progress("payload") as report:
        payload = identify_payload(
            fit,
            recordings,
            cutoff=args.cutoff,
            refit_friction=args.refit_friction,
            progress=report,
        )
    files = output.Files()
    files.add_json(args.json, payload.to_dict())
    files.add_html(args.html, lambda: payload_report(fit, payload))
    files.add_picture(args.plot, payload.plot)
    files.write()
    print_payload(payload)


def print_payload(payload: PayloadEstimate) -> None:
    """Print the verdict, the quantities, the errors and what cannot be identified."""
    output.say(payload.sentence)
    output.table(
        "Payload in the tool frame; inertia about the centre of mass",
        ["", "value", "std", "95 % from", "to", "feasible", "unit"],
        [
            [
                row["name"] + ("" if row["identified"] else " *"),
                row["value"],
                row["std"],
                *(row["interval"] or (None, None)),
                row["feasible"],
                row["unit"],
            ]
            for row in payload.table()
        ],
    )
    by_reason: dict[str, list[str]] = {}
    for part in payload.not_identified:
        by_reason.setdefault(part.reason, []).append(part.name)
    for reason, names in by_reason.items():
        output.say(f"  * not identified: {', '.join(names)}; {reason}.")
    output.table(
        f"RMS error in motion, N·m (low-pass {payload.cutoff:.3g} Hz)",
        ["joint", "fit alone", "with the payload", "feasible", "the fit's own, held out"],
        [
            [f"{j + 1} {name}", *(float(x) for x in row)]
            for j, (name, row) in enumerate(
                zip(
                    payload.joint_names,
                    zip(
                        payload.rms_before,
                        payload.rms_after,
                        payload.feasible.rms_after,
                        payload.rms_fit,
                        strict=True,
                    ),
                    strict=True,
                )
            )
        ],
    )
    if payload.friction:
        output.table(
            "Friction in the loaded run",
            ["number", "in the fit", "change", "std", "unit"],
            [
                [f"{part.name}:{part.joint + 1}", part.fitted, part.change, part.std, part.unit]
                for part in payload.friction
            ],
        )
    output.show_warnings(payload.warnings)
