"""``lieid payload FIT REC…``: identify the payload at the tool."""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING, Any

from lieid_casadi.cli import effects_file, output, shared_options
from lieid_casadi.cli.option_types import InputPath, PictureFile, number
from lieid_casadi.errors import UsageError

if TYPE_CHECKING:
    from lieid_casadi.payload import PayloadEstimate


def add_parser(commands: Any) -> None:
    """Add the command."""
    parser = commands.add_parser(
        "payload",
        help="mass, centre of mass and inertia of the payload",
        description="Identify the mass, centre of mass and inertia of a payload with a fit that "
        "was made without it.",
    )
    parser.add_argument("fit", type=InputPath, metavar="FIT", help="fit made without the payload")
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
    parser.add_argument(
        "--torque-constants-std",
        metavar="PERCENT[,…]",
        help="standard deviation of the torque constants, %%: one number for an error that all "
        "joints share, or one per joint; default: 0",
    )
    effects_file.add_option(parser)
    shared_options.add_recording_options(parser)
    shared_options.add_outputs(parser, html=True)
    shared_options.add_threads(parser)
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> None:
    """Identify, print and write."""
    from lieid_casadi.identification import Fit
    from lieid_casadi.payload import identify_payload
    from lieid_casadi.report import payload_report

    effects_file.load(args.effects_file)
    fit = Fit.load(args.fit)
    recordings = shared_options.recordings_of(args.recordings, args, fit)
    with output.progress("payload") as report:
        payload = identify_payload(
            fit,
            recordings,
            cutoff=args.cutoff,
            refit_friction=args.refit_friction,
            torque_constant_std=_percent(args.torque_constants_std),
            progress=report,
        )
    files = output.Files()
    files.add_json(args.json, payload.to_dict())
    files.add_html(args.html, lambda: payload_report(fit, payload))
    files.add_picture(args.plot, payload.plot)
    files.write()
    print_payload(payload)


def _percent(text: str | None) -> list[float]:
    """Return numbers in percent as fractions."""
    try:
        return [0.01 * number(part) for part in (text or "0").split(",")]
    except argparse.ArgumentTypeError as error:
        raise UsageError(f"--torque-constants-std {text}: {error}") from None


def print_payload(payload: PayloadEstimate) -> None:
    """Print the verdict, the quantities, the errors, and what cannot be identified."""
    from lieid_casadi.payload import view

    output.say(payload.sentence)
    output.show(view.quantity_table(payload))
    for names, reason in view.not_identified(payload):
        output.say(f"  * not identified: {names}; {reason}.")
    output.show(view.error_table(payload), view.friction_table(payload))
    output.show_warnings(payload.warnings)
