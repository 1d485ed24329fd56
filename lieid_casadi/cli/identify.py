"""``lieid identify ROBOT TRAIN… [--test T…] -o fit.json``."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from lieid_casadi.cli import inputs, options, output
from lieid_casadi.cli.check import DESPITE_CHECK, premises_of
from lieid_casadi.cli.option_types import FrictionRun, known_mass
from lieid_casadi.cli.options import Command, Group, option, several
from lieid_casadi.errors import UsageError
from lieid_casadi.tables import make_table

if TYPE_CHECKING:
    from lieid_casadi.comparison import Comparison
    from lieid_casadi.friction_curves import StagedFit
    from lieid_casadi.identification import Fit
    from lieid_casadi.model import Model
    from lieid_casadi.recording import Recording

METHODS = ("ols", "wls", "robust", "feasible")


def run(args: argparse.Namespace) -> output.Outcome:
    """Fit, and compare with the test recordings."""
    from lieid_casadi.comparison import compare
    from lieid_casadi.identification import identify
    from lieid_casadi.report import comparison_report, fit_report

    robot = inputs.robot_of(args)
    train = inputs.recordings_of(args.train, args, robot)
    test = inputs.recordings_of(args.test, args, robot)
    premises = premises_of(args, robot, train, test)
    model = inputs.model_for(args, robot, train)
    stages = _in_stages(model, train, args) if args.friction_runs else None
    if stages is not None:
        fit = stages.fit
    elif args.known_mass:
        fit = _with_known_masses(model, train, args)
        if laws := fit.model.robot.drives:
            test = [recording.with_drives(laws) for recording in test]
    else:
        with output.progress("identify") as report:
            fit = identify(
                model,
                train,
                method=args.method,
                processing=inputs.processing_of(args),
                progress=report,
            )
    comparison = compare(fit, test) if test else None
    content = result(fit, comparison) | {"premises": premises}
    if stages is not None:
        content["stages"] = {"refit": not args.no_refit, **stages.to_dict()}

    def show() -> None:
        if stages is not None:
            _print_stages(stages)
        print_fit(fit, comparison)

    return output.Outcome(
        show,
        fit=fit,
        json=content,
        html=lambda: fit_report(fit) if comparison is None else comparison_report(fit, comparison),
    )


STAGES = Group(
    "identification in stages",
    (
        several(
            "--friction-runs J=REC",
            "recordings in which joint J moves forward and backward and the others stand still",
            FrictionRun,
        ),
        option(
            "--friction-effects A,B,…",
            "friction model of these joints: effects, or the name of a model",
            default="paper",
        ),
        option(
            "--friction-load",
            "source of the load torque of the friction runs; measured for runs with a payload; "
            "default: model",
            choices=("model", "measured"),
        ),
        option("--no-refit", "leave out the third stage, as the paper does"),
    ),
    "With --friction-runs, TRAIN identifies the links, the friction runs of single joints identify "
    "friction over speed and load, and TRAIN identifies the links and the friction that grows with "
    "speed again (Luo et al. 2024, Eqs. 11 to 16, and a third stage).",
)
COMMANDS = (
    Command(
        "identify",
        "fit a model to recordings",
        "Identify the base parameters and the effects of a model from recordings.",
        (
            *options.ROBOT,
            several("train TRAIN", "recording to fit; REC@T0:T1 is the part from T0 to T1 seconds"),
            several("--test T", options.TEST),
            option(
                "--method",
                "ordinary, weighted or robust least squares, or weighted least squares with "
                "physically consistent masses and inertias (feasible)",
                default="wls",
                choices=METHODS,
            ),
            options.output_file("fit.json", "write the fit"),
            options.effects(None),
            options.MOTOR_SIDE,
            STAGES,
            *options.RECORDING,
            several(
                "--known-mass LINK=KG",
                "masses of links that determine an unknown stiffness (--stiffness unknown)",
                known_mass,
            ),
            *options.PROCESSING,
            DESPITE_CHECK,
            options.JSON,
            options.HTML,
        ),
        run,
    ),
)


def _with_known_masses(
    model: Model, recordings: Sequence[Recording], args: argparse.Namespace
) -> Fit:
    from lieid_casadi.identification.known_mass import identify_with_known_masses

    with output.progress("identify") as report:
        return identify_with_known_masses(
            model,
            recordings,
            dict(args.known_mass),
            method=args.method,
            processing=inputs.processing_of(args),
            progress=report,
        )


def _in_stages(
    model: Model, recordings: Sequence[Recording], args: argparse.Namespace
) -> StagedFit:
    from lieid_casadi.friction_curves import identify_in_stages
    from lieid_casadi.recording import Processing

    paths: dict[int, list[str]] = {}
    for run in args.friction_runs:
        if run.joint >= model.n:
            raise UsageError(
                f"--friction-runs {run.joint + 1}={run}: {model.robot.name} has joints 1 to "
                f"{model.n}"
            )
        paths.setdefault(run.joint, []).append(run)
    return identify_in_stages(
        model,
        recordings,
        {joint: inputs.recordings_of(paths[joint], args, model.robot) for joint in sorted(paths)},
        args.friction_effects,
        refit=not args.no_refit,
        method=args.method,
        load=args.friction_load,
        processing=inputs.processing_of(args),
        friction_processing=Processing(cutoff=args.cutoff),
    )


def _print_stages(stages: StagedFit) -> None:
    """Print how well the friction model fits each joint, and the errors of the first stage."""
    output.show(
        make_table(
            "Friction of single joints (second stage)",
            [
                "joint",
                "points",
                "RMS",
                "correlation",
                "unit",
                "train error of the first stage, N·m",
            ],
            [
                [
                    f"{joint + 1} {own.curve.joint_name}",
                    len(own.curve),
                    own.rms,
                    f"{own.correlation:.4f}",
                    own.curve.unit,
                    float(stages.first_stage.rms_train[joint]),
                ]
                for joint, own in stages.friction.items()
            ],
        )
    )


def result(fit: Fit, comparison: Comparison | None) -> dict[str, Any]:
    """Return the JSON of ``lieid identify``."""
    content = fit.to_dict()
    tested = comparison.to_dict() if comparison is not None else None
    for key, name in (
        ("rms_test", "rms"),
        ("rms_test_moving", "rms_moving"),
        ("rms_test_at_rest", "rms_at_rest"),
        ("rms_test_raw", "rms_raw"),
        ("correlation_test", "correlation"),
    ):
        content[key] = tested[name] if tested is not None else None
    if tested is not None:
        content["test"] = tested
        del content["rms_cv"]
        seen = content["warnings"]
        content["warnings"] = seen + [w for w in tested["warnings"] if w not in seen]
    return content


def print_fit(fit: Fit, comparison: Comparison | None) -> None:
    """Print errors per joint, parameters and warnings."""
    from lieid_casadi.identification.fit_view import parameter_table

    columns, values = ["joint"], list[tuple[float, ...]]()
    if comparison is None:
        columns += ["cross-validated, in motion", "train", "train raw"]
        values += zip(fit.rms_cv, fit.rms_train, fit.rms_train_raw, strict=True)
    else:
        test = comparison
        columns += ["test in motion", "% of torque", "at rest", "test", "test raw", "correlation"]
        columns += ["train", "train raw"]
        relative = 100.0 * test.relative_rms_moving
        tested = (test.rms_moving, relative, test.rms_at_rest, test.rms, test.rms_raw)
        values += zip(*tested, test.correlation, fit.rms_train, fit.rms_train_raw, strict=True)
    rows = [
        [f"{j + 1} {joint.name}", *map(float, own)]
        for j, (joint, own) in enumerate(zip(fit.model.robot.joints, values, strict=True))
    ]
    filter_ = f"low-pass {fit.processing.cutoff:.3g} Hz on measured and predicted torque"
    output.show(make_table(f"RMS error, N·m ({filter_})", columns, rows))
    output.show(parameter_table(fit))
    c = fit.conditioning
    output.say(
        f"Condition number {c.condition_number:.4g} (σ₁ {c.largest:.4g}, σ_r {c.smallest:.4g}, "
        f"σ_r+1 {c.beyond:.1g}; full regressor, SI). "
        f"Physically consistent: {'yes' if fit.physically_consistent else 'no'}."
    )
    if fit.certificate is not None:
        output.say(fit.certificate.summary())
    output.show_warnings(fit.warnings)
    if comparison is not None:
        printed = {str(w) for w in fit.warnings}
        output.show_warnings([w for w in comparison.warnings if str(w) not in printed])
