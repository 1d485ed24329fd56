"""``lieid identify ROBOT TRAIN… [--test T…] -o fit.json``."""

from __future__ import annotations

import time
from collections.abc import Iterable, Iterator, Sequence
from typing import Any

import lieid_casadi as lieid
from lieid_casadi.cli import inputs, output
from lieid_casadi.cli.check import premises_of
from lieid_casadi.cli.options import Args, command
from lieid_casadi.errors import LieidWarning, UsageError
from lieid_casadi.tables import Table, figures, make_table


@command("identify", "fit a model to recordings")
def run(args: Args) -> output.Outcome:
    """Identify the base parameters and the effects of a model from recordings.

    @ROBOT
    train TRAIN …: input  recording to fit; REC@T0:T1 is the part from T0 to T1 seconds
    --test T …: input  recordings to test on, which are not fitted
    --method {ols,wls,robust,feasible} = wls  ordinary, weighted or robust least squares, or
        weighted least squares with physically consistent masses and inertias (feasible)
    --polish  refine the effects so that the simulated motion under commands is that of
        TRAIN (--method feasible, drives); takes a minute
    -o/--output fit.json: output  write the fit
    @EFFECTS_BY_RECORDING @RECORDING
    --known-mass LINK=KG …: mass  masses of links that determine an unknown stiffness
        (--stiffness unknown)
    @PROCESSING @DESPITE_CHECK @JSON @HTML
    """
    from lieid_casadi.identification.known_mass import (
        identify_each_stiffness,
        identify_with_known_masses,
    )
    from lieid_casadi.report import comparison_report, fit_report

    robot = inputs.robot_of(args)
    train = inputs.recordings_of(args.train, args, robot)
    test = inputs.recordings_of(args.test, args, robot)
    premises = premises_of(args, robot, train, test)
    model = inputs.model_for(args, robot, train)
    options = {"method": args.method, "processing": lieid.Processing(cutoff=args.cutoff)}
    with output.progress("identify") as report:
        if args.known_mass:
            masses = dict(args.known_mass)
            fit = identify_with_known_masses(model, train, masses, **options, progress=report)
        elif args.stiffness == "each":
            fit = identify_each_stiffness(model, train, **options, progress=report)
        else:
            fit = lieid.identify(model, train, **options, progress=report)
    if (laws := fit.model.robot.drives) and laws != robot.drives:  # stiffnesses were found
        test = [recording.with_drives(laws) for recording in test]
    polished = []
    if args.polish:
        fit, sentence = _polished(fit, train)
        polished = [sentence]
    comparison = lieid.compare(fit, test) if test else None
    return output.Outcome(
        [*shown(fit, comparison), *polished],
        fit=fit,
        json=content(fit, comparison) | {"premises": premises},
        html=lambda: fit_report(fit) if comparison is None else comparison_report(fit, comparison),
    )


def _polished(fit: lieid.Fit, train: Sequence[lieid.Recording]) -> tuple[lieid.Fit, str]:
    """Refine a fit on the motion that it predicts; return it, and what that has changed."""
    import numpy as np

    from lieid_casadi.simulation import polish

    if fit.method != "feasible":
        raise UsageError("--polish: simulation needs positive masses; expected --method feasible")
    start = time.monotonic()
    with output.progress("polish") as report:
        found = polish(fit, train, progress=report)
    before, after = (
        ", ".join(f"{x:.2g}" for x in np.degrees(rms)) for rms in (found.before, found.after)
    )
    return found.fit, (
        f"Polished on the motion in {time.monotonic() - start:.0f} s: RMS error of the position in "
        f"windows of 1 s from {before} to {after} deg per joint."
    )


def content(fit: lieid.Fit, comparison: lieid.Comparison | None) -> dict[str, Any]:
    """Return the JSON of ``lieid identify``."""
    found = fit.to_dict()
    tested = {} if comparison is None else comparison.to_dict()
    for key, name in (
        ("rms_test", "rms"),
        ("rms_test_moving", "rms_moving"),
        ("rms_test_at_rest", "rms_at_rest"),
        ("rms_test_raw", "rms_raw"),
        ("correlation_test", "correlation"),
    ):
        found[key] = tested.get(name)
    if tested:
        found["test"] = tested
        del found["rms_cv"]
        seen = found["warnings"]
        found["warnings"] = seen + [w for w in tested["warnings"] if w not in seen]
    return found


def shown(
    fit: lieid.Fit, comparison: lieid.Comparison | None
) -> Iterator[str | Table | LieidWarning]:
    """Yield errors per joint, parameters and warnings."""
    from lieid_casadi.identification.fit import parameter_table

    columns, values = ["joint"], list[Iterable[object]]()
    if comparison is None:
        columns += ["cross-validated, in motion", "train", "train raw"]
        values += [map(figures, fit.rms_cv)]
    else:
        test = comparison
        columns += ["test in motion", "% of torque", "at rest", "test", "test raw", "correlation"]
        columns += ["train", "train raw"]
        relative = (100.0 * test.relative_rms_moving).tolist()
        values += [map(figures, test.rms_moving), relative]
        values += [map(figures, x) for x in (test.rms_at_rest, test.rms, test.rms_raw)]
        values += [test.correlation.tolist()]
    values += [map(figures, x) for x in (fit.rms_train, fit.rms_train_raw)]
    names = (f"{j} {joint.name}" for j, joint in enumerate(fit.model.robot.joints, start=1))
    rows = zip(names, *values, strict=True)
    filter_ = f"low-pass {fit.processing.cutoff:.3g} Hz on measured and predicted torque"
    yield make_table(f"RMS error, N·m ({filter_})", columns, rows)
    yield parameter_table(fit)
    c = fit.conditioning
    yield (
        f"Condition number {c.condition_number:.4g} (σ₁ {c.largest:.4g}, σ_r {c.smallest:.4g}, "
        f"σ_r+1 {c.beyond:.1g}; full regressor, SI). "
        f"Physically consistent: {'yes' if fit.physically_consistent else 'no'}."
    )
    if fit.certificate is not None:
        yield fit.certificate.summary()
    yield from fit.warnings
    if comparison is not None:
        printed = {str(w) for w in fit.warnings}
        yield from (w for w in comparison.warnings if str(w) not in printed)
