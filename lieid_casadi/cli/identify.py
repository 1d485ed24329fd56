"""``lieid identify ROBOT TRAIN… [--test T…] -o fit.json``."""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING, Any

from lieid_casadi.cli import output, shared_options
from lieid_casadi.cli.option_types import InputPath, OutputFile

if TYPE_CHECKING:
    from lieid_casadi.comparison import Comparison
    from lieid_casadi.identification import Fit

METHODS = ("ols", "wls", "robust", "feasible")


def add_parser(commands: Any) -> None:
    """Add the command."""
    parser = commands.add_parser("identify", help="fit a model to recordings")
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
        help="recordings that are not fitted",
    )
    parser.add_argument("--method", choices=METHODS, default="wls")
    parser.add_argument("-o", "--output", type=OutputFile, metavar="fit.json", help="write the fit")
    shared_options.add_effects(parser)
    shared_options.add_recording_options(parser)
    shared_options.add_processing(parser)
    shared_options.add_outputs(parser, html=True)
    shared_options.add_threads(parser)
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> None:
    """Fit, compare with the test recordings, print and write."""
    from lieid_casadi.comparison import compare
    from lieid_casadi.identification import identify
    from lieid_casadi.report import comparison_report, fit_report

    model = shared_options.model_of(args)
    train = shared_options.training_of(args.train, args, model.robot)
    test = shared_options.recordings_of(args.test, args, model.robot)
    with output.progress("identify") as report:
        fit = identify(
            model,
            train,
            method=args.method,
            processing=shared_options.processing_of(args),
            progress=report,
        )
    comparison = compare(fit, test) if test else None
    files = output.Files()
    files.add_fit(args.output, fit)
    files.add_json(args.json, result(fit, comparison))
    files.add_html(
        args.html,
        lambda: fit_report(fit) if comparison is None else comparison_report(fit, comparison),
    )
    files.write()
    print_fit(fit, comparison)


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
    columns = ["joint", "train", "train raw"]
    columns += (
        ["test", "test raw", "% of torque", "moving", "at rest", "correlation"]
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
    output.table(f"RMS error, N·m ({filter_})", columns, rows)
    output.table(
        f"{fit.model.base.count} base parameters and {len(fit.shapes)} shapes, method {fit.method}",
        ["parameter", "value", "std", "std %", "unit"],
        [
            [
                row["expression"],
                row["value"],
                row["std"],
                None
                if not row["value"] or row["std"] is None
                else 100 * row["std"] / abs(row["value"]),
                row["unit"],
            ]
            for row in fit.parameter_table()
        ],
    )
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
        known = {str(w) for w in fit.warnings}
        output.show_warnings([w for w in comparison.warnings if str(w) not in known])
