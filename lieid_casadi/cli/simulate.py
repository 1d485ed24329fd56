"""``lieid simulate FIT REC -o sim.csv``: how far a simulated motion leaves the measured one."""

from __future__ import annotations

import argparse
from typing import Any

from lieid_casadi.cli import effects_file, output, shared_options
from lieid_casadi.cli.drive_options import drives_of
from lieid_casadi.cli.option_types import InputPath, OutputFile, PictureFile, number
from lieid_casadi.errors import UsageError


def add_parser(commands: Any) -> None:
    """Add the command."""
    parser = commands.add_parser(
        "simulate",
        help="forward simulation of a fit under recorded torques or commands",
        description="Integrate a fit from measured states under the torques or commands of "
        "recordings, and report how far the simulated motion leaves the measured one.",
    )
    parser.add_argument("fit", type=InputPath, metavar="FIT", help="fit to simulate")
    parser.add_argument(
        "recordings", nargs="+", type=InputPath, metavar="REC", help="recordings to follow"
    )
    parser.add_argument(
        "-o",
        "--output",
        type=OutputFile,
        metavar="sim.csv",
        help="CSV file with the simulated motion t,q1…qn,dq1…dqn, restarted in every window",
    )
    parser.add_argument(
        "--window", type=number, default=1.0, metavar="S", help="length of the windows; default: 1"
    )
    parser.add_argument(
        "--under",
        choices=("command", "torque"),
        help="input; default: commands if the fit has a drive law and the recordings have them",
    )
    parser.add_argument(
        "--no-effects",
        action="store_true",
        help="leave out the models without one effect of the fit each",
    )
    parser.add_argument(
        "--train",
        nargs="+",
        type=InputPath,
        metavar="REC",
        help="recordings from which the models without an effect are identified; default: the "
        "simulated recordings",
    )
    parser.add_argument(
        "--train-episodes", metavar="A:B", help="episodes of datasets after --train; default: all"
    )
    parser.add_argument("--plot", type=PictureFile, metavar="FILE", help="draw the drift per joint")
    shared_options.add_recording_options(parser)
    effects_file.add_option(parser)
    shared_options.add_outputs(parser)
    shared_options.add_threads(parser)
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> None:
    """Simulate, print and write."""
    from dataclasses import replace

    from lieid_casadi.identification import Fit
    from lieid_casadi.simulation import simulate
    from lieid_casadi.simulation.view import drift_table, effects_table

    if not args.window > 0.0:
        raise UsageError(f"--window {args.window:g}: expected seconds above 0")
    effects_file.load(args.effects_file)
    fit = Fit.load(args.fit)
    recordings = shared_options.recordings_of(args.recordings, args, fit)
    own = argparse.Namespace(**vars(args) | {"episodes": args.train_episodes})
    train = shared_options.recordings_of(args.train, own, fit) if args.train else None
    drives = drives_of(args, fit.model.robot)
    if drives is not None:
        robot = fit.model.robot.with_drives(drives)
        model = type(fit.model).of_placements(robot, fit.model.placements)
        fit = replace(fit, model=model)
    with output.progress("simulate") as report:
        simulation = simulate(
            fit,
            recordings,
            window=args.window,
            under=args.under,
            each_effect=not args.no_effects,
            train=train,
            progress=report,
        )
    files = output.Files()
    files.add(args.output, lambda: _csv(simulation))
    files.add_json(args.json, simulation.to_dict())
    files.add_picture(args.plot, simulation.plot)
    files.write()
    output.show(drift_table(simulation), effects_table(simulation))
    output.show_warnings(simulation.warnings)


def _csv(simulation: Any) -> bytes:
    """Return the simulated motion as CSV."""
    import io

    import numpy as np

    n = simulation.q.shape[1]
    header = ["t", *(f"{name}{j}" for name in ("q", "dq") for j in range(1, n + 1))]
    text = io.StringIO()
    np.savetxt(
        text,
        np.column_stack([simulation.t, simulation.q, simulation.dq]),
        fmt=["%.15g", *["%.9g"] * (2 * n)],
        delimiter=",",
        header=",".join(header),
        comments="",
    )
    return text.getvalue().encode()
