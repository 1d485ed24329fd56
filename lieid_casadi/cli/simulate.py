"""``lieid simulate FIT REC -o sim.csv``: how far a simulated motion leaves the measured one."""

from __future__ import annotations

import lieid_casadi as lieid
from lieid_casadi.cli import inputs, output
from lieid_casadi.cli.options import Args, command


@command("simulate", "forward simulation of a fit under recorded torques or commands")
def run(args: Args) -> output.Outcome:
    """Integrate a fit from measured states under the torques or commands of recordings.

    It is reported how far the simulated motion leaves the measured one.

    fit FIT: input  fit to simulate
    recordings REC …: input  recordings to follow
    -o/--output sim.csv: output  CSV file with the simulated motion t,q1…qn,dq1…dqn,
        restarted in every window
    --window S: above = 1  length of the windows
    --under {command,torque}  input; default: commands if the fit has a drive law and the
        recordings have them
    @RECORDING @JSON
    """
    from dataclasses import replace

    from lieid_casadi.simulation.simulate import drift_table

    fit, recordings = inputs.fit_and_recordings(args)
    drives = inputs.drives_of(args, fit.model.robot)
    if drives is not None:
        robot = fit.model.robot.with_drives(drives)
        model = type(fit.model).of_placements(robot, fit.model.placements)
        fit = replace(fit, model=model)
    with output.progress("simulate") as report:
        simulation = lieid.simulate(
            fit, recordings, window=args.window, under=args.under, progress=report
        )
    motion = {"q": simulation.q, "dq": simulation.dq}
    return output.Outcome(
        (drift_table(simulation), *simulation.warnings),
        json=simulation.to_dict(),
        files={"output": lambda: output.csv_bytes(simulation.t, **motion)},
    )
