"""``lieid identify ROBOT TRAIN… [--test T…] -o fit.json``."""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING, Any

from lieid_casadi.cli import output, shared_options
from lieid_casadi.cli.option_types import FrictionRun, InputPath, OutputFile
from lieid_casadi.errors import UsageError
from lieid_casadi.tables import make_table

if TYPE_CHECKING:
    from lieid_casadi.comparison import Comparison
    from lieid_casadi.friction_curves import StagedFit
    from lieid_casadi.identification import Fit
    from lieid_casadi.model import Model

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
    parser.add_argument("--method", choices=METHODS, default="wls", help="estimator; default: wls")
    parser.add_argument("-o", "--output", type=OutputFile, metavar="fit.json", help="write the fit")
    shared_options.add_effects(parser)
    _add_stages(parser)
    shared_options.add_recording_options(parser)
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

    model = shared_options.model_of(args)
    test = shared_options.recordings_of(args.test, args, model.robot)
    stages = _in_stages(model, args) if args.friction_runs else None
    if stages is not None:
        fit = stages.fit
    else:
        train = shared_options.training_of(args.train, args, model.robot)
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


def _in_stages(model: Model, args: argparse.Namespace) -> StagedFit:
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
        shared_options.recordings_of(args.train, args, model.robot),
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

    columns = ["joint", "train", "train raw"]
    columns += (
        ["test", "test raw", "% of torque", "in motion", "at rest", "correlation"]
        if comparison
        else ["cross-validated"]
    )
    rows: list[list[object]] = []
    for j, joint in enumerate(fit.model.robot.joints):
        row: list[object] = [
            f"{j + 1} {joint.name}",
            float(fit.rms_train[j]),
            float(fit.rms_train_raw[j]),
        ]
        if comparison is not None:
            row += [
                float(comparison.rms[j]),
                float(comparison.rms_raw[j]),
                100.0 * float(comparison.relative_rms[j]),
                float(comparison.rms_moving[j]),
                float(comparison.rms_at_rest[j]),
                f"{comparison.correlation[j]:.5f}",
            ]
        else:
            row.append(float(fit.rms_cv[j]))
        rows.append(row)
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
