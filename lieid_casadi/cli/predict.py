"""``lieid predict FIT REC -o pred.csv``: torque at the recording's own times."""

from __future__ import annotations

from lieid_casadi.cli import inputs, output
from lieid_casadi.cli.options import Args, command


@command("predict", "torque of a fit along a recording")
def run(args: Args) -> output.Outcome:
    """Compute the torque of a fit at the times of a recording.

    fit FIT: input  fit to evaluate
    recording REC: input  recording that states the motion
    -o/--output pred.csv: output required  CSV file with the columns t,tau1…taun
    @RECORDING
    """
    fit, (recording,) = inputs.fit_and_recordings(args, [args.recording])
    torque = fit.predict(recording)
    return output.Outcome(
        [f"{len(torque)} rows written to {args.output}"],
        files={"output": lambda: output.csv_bytes(recording.t, tau=torque)},
    )
