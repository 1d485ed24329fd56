"""``lieid identify ROBOT TRAIN… [--test T…] -o fit.json``."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from lieid_casadi.cli import effects_file, output, shared_options, torque_options
from lieid_casadi.cli.drive_options import known_mass
from lieid_casadi.cli.option_types import FrictionRun, InputPath, OutputFile
from lieid_casadi.errors import UsageError
from lieid_casadi.tables import make_table

if TYPE_CHECKING:
    from lieid_casadi.comparison import Comparison
    from lieid_casadi.friction_curves import StagedFit
    from lieid_casadi.identification import Fit
    from lieid_casadi.model import Model
    from lieid_casadi.recording import Recording

METHODS = ("ols", "wls", "robust", "feasible")


def add_parser(commands: Any) -> None:
    """Add the command."""
    parser = commands.add_parser(
        "identify",
        help="fit a model to recordings",
        description="Identify the base parameters and the effects of a model from recordings.",
    )
    shared_options.add_robot(parser)
    parser.add_argument(
        "train",
        nargs="+",
        type=InputPath,
        metavar="TRAIN",
        help="recording to fit; REC@T0:T1 is the part from T0 to T1 seconds",
    )
    parser.add_argument(
        "--test",
        nargs="+",
        type=InputPath,
        default=[],
        metavar="T",
        help="recordings to test on, which are not fitted",
    )
    parser.add_argument(
        "--method",
        choices=METHODS,
        default="wls",
        help="ordinary, weighted or robust least squares, or weighted least squares with "
        "physically consistent masses and inertias (feasible); default: wls",
    )
    parser.add_argument("-o", "--output", type=OutputFile, metavar="fit.json", help="write the fit")
    shared_options.add_effects(parser, default=None)
    torque_options.add_motor_side(parser)
    _add_stages(parser)
    shared_options.add_recording_options(parser)
    parser.add_argument(
        "--known-mass",
        nargs="+",
        type=known_mass,
        default=[],
        metavar="LINK=KG",
        help="masses of links that determine an unknown stiffness (--stiffness unknown)",
    )
    shared_options.add_processing(parser)
    shared_options.add_outputs(parser, html=True)
    shared_options.add_threads(parser)
    parser.set_defaults(run=run)


def _add_stages(parser: argparse.ArgumentParser) -> None:
    group = parser.add_argument_group(
        "identification in stages",
        "With --friction-runs, TRAIN identifies the links, the friction runs of single joints "
        "identify friction over speed and load, and TRAIN identifies the links and the friction "
        "that grows with speed again (Luo et al. 2024, Eqs. 11 to 16, and a third stage).",
    )
    group.add_argument(
        "--friction-runs",
        nargs="+",
        type=FrictionRun,
        default=[],
        metavar="J=REC",
        help="recordings in which joint J moves forward and backward and the others stand still",
    )
    group.add_argument(
        "--friction-effects",
        default="paper",
        metavar="A,B,…",
        help="friction model of these joints: effects, or the name of a model; default: paper",
    )
    group.add_argument(
        "--friction-load",
        choices=("model", "measured"),
        help="source of the load torque of the friction runs; measured for runs with a payload; "
        "default: model",
    )
    group.add_argument(
        "--no-refit", action="store_true", help="leave out the third stage, as the paper does"
    )


def run(args: argparse.Namespace) -> None:
    """Fit, compare with the test recordings, print and write."""
    from lieid_casadi.comparison import compare
    from lieid_casadi.identification import identify
    from lieid_casadi.report import comparison_report, fit_report

    effects_file.load(args.effects_file)
    robot = shared_options.robot_of(args)
    in_memory = bool(args.friction_runs or args.known_mass)
    recordings = shared_options.recordings_of(args.train, args, robot) if in_memory else []
    train = recordings or shared_options.training_of(args.train, args, robot)
    model = torque_options.model_for(args, robot, train)
    test = shared_options.recordings_of(args.test, args, robot)
    stages = _in_stages(model, recordings, args) if args.friction_runs else None
    if stages is not None:
        fit = stages.fit
    elif args.known_mass:
        fit = _with_known_masses(model, recordings, args)
        if laws := fit.model.robot.drives:
            test = [recording.with_drives(laws) for recording in test]
    else:
        with output.progress("identify") as report:
            fit = identify(
                model,
                train,
                method=args.method,
                processing=shared_options.processing_of(args),
                progress=report,
            )
    comparison = compare(fit, test) if test else None
    content = result(fit, comparison)
    if stages is not None:
        content["stages"] = {"refit": not args.no_refit, **stages.to_dict()}
    files = output.Files()
    files.add_fit(args.output, fit)
    files.add_json(args.json, content)
    files.add_html(
        args.html,
        lambda: fit_report(fit) if comparison is None else comparison_report(fit, comparison),
    )
    files.write()
    if stages is not None:
        _print_stages(stages)
    print_fit(fit, comparison)


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
            processing=shared_options.processing_of(args),
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
        {
            joint: shared_options.recordings_of(paths[joint], args, model.robot)
            for joint in sorted(paths)
        },
        args.friction_effects,
        refit=not args.no_refit,
        method=args.method,
        load=args.friction_load,
        processing=shared_options.processing_of(args),
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
