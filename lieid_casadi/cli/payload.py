"""``lieid payload FIT REC…``: identify the payload at the tool."""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING

from lieid_casadi.cli import inputs, options, output
from lieid_casadi.cli.check import DESPITE_CHECK, premises_of
from lieid_casadi.cli.option_types import InputPath, number
from lieid_casadi.cli.options import Command, option, several
from lieid_casadi.errors import UsageError

if TYPE_CHECKING:
    from lieid_casadi.payload import PayloadEstimate


def run(args: argparse.Namespace) -> output.Outcome:
    """Identify the payload."""
    from lieid_casadi.payload import identify_payload
    from lieid_casadi.report import payload_report

    fit, recordings = inputs.fit_and_recordings(args)
    premises = premises_of(args, fit, recordings)
    with output.progress("payload") as report:
        payload = identify_payload(
            fit,
            recordings,
            cutoff=args.cutoff,
            refit_friction=args.refit_friction,
            torque_constant_std=_percent(args.torque_constants_std),
            progress=report,
        )
    return output.Outcome(
        lambda: print_payload(payload),
        json=payload.to_dict() | {"premises": premises},
        html=lambda: payload_report(fit, payload),
        plot=payload.plot,
    )


COMMANDS = (
    Command(
        "payload",
        "mass, centre of mass and inertia of the payload",
        "Identify the mass, centre of mass and inertia of a payload with a fit that was made "
        "without it.",
        (
            option("fit FIT", "fit made without the payload", InputPath),
            several("recordings REC", "recordings measured with the payload"),
            option(
                "--refit-friction",
                "fit Coulomb friction, viscous friction and offsets again, which change with "
                "temperature",
            ),
            option(
                "--cutoff HZ",
                "cut-off frequency of the low-pass filter; default: that of the fit",
                number,
            ),
            options.plot("draw the errors before and after"),
            option(
                "--torque-constants-std PERCENT[,…]",
                "standard deviation of the torque constants, %%: one number for an error that all "
                "joints share, or one per joint; default: 0",
            ),
            *options.RECORDING,
            DESPITE_CHECK,
            options.JSON,
            options.HTML,
        ),
        run,
    ),
)


def _percent(text: str | None) -> list[float]:
    """Return numbers in percent as fractions."""
    try:
        return [0.01 * number(part) for part in (text or "0").split(",")]
    except argparse.ArgumentTypeError as error:
        raise UsageError(f"--torque-constants-std {text}: {error}") from None


def print_payload(payload: PayloadEstimate) -> None:
    """Print the verdict, the quantities, the errors, and what cannot be identified."""
    from lieid_casadi.payload.estimate import (
        error_table,
        friction_table,
        not_identified,
        quantity_table,
    )

    output.say(payload.sentence)
    output.show(quantity_table(payload))
    for names, reason in not_identified(payload):
        output.say(f"  * not identified: {names}; {reason}.")
    output.show(error_table(payload), friction_table(payload))
    output.show_warnings(payload.warnings)
