"""``lieid demo [-o DIR]``: the main job on a simulated arm, no robot or data needed."""

from __future__ import annotations

import argparse
import shutil
from pathlib import Path
from typing import TYPE_CHECKING, Any

from lieid_casadi.cli import output, shared_options
from lieid_casadi.errors import UsageError

if TYPE_CHECKING:
    from lieid_casadi.demo import Demo

MARK = "lieid-demo.txt"  # says that a folder was made here and may be replaced


def add_parser(commands: Any) -> None:
    """Add the command."""
    parser = commands.add_parser("demo", help="the whole loop on a simulated arm")
    parser.add_argument("-o", "--output", default="lieid-demo", metavar="DIR")
    parser.add_argument("--robot", default="panda", metavar="ROBOT", help="default: panda")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--force", action="store_true", help="replace a folder with other content")
    shared_options.add_outputs(parser)
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> None:
    """Run the loop and write recordings, fits, plots and the report into a folder."""
    from lieid_casadi.demo import run_demo
    from lieid_casadi.robot import Robot

    folder = Path(args.output)
    check_replaceable(folder, force=args.force)
    output.check_writable(args.json)
    with output.progress("demo") as report:
        demo = run_demo(Robot.load(args.robot), seed=args.seed, progress=report)
    write(demo, folder)
    output.write_json(args.json, content(demo))
    show(demo, folder)


def check_replaceable(folder: Path, *, force: bool) -> None:
    """Refuse a non-empty folder that the demo did not make, unless forced."""
    output.check_writable(folder / MARK)
    if folder.is_file():
        raise UsageError(f"{folder}: is a file; expected a folder")
    if folder.is_dir() and any(folder.iterdir()) and not (folder / MARK).exists() and not force:
        raise UsageError(f"{folder}: not empty and not made by lieid demo; --force replaces it")


def write(demo: Demo, folder: Path) -> None:
    """Write everything beside the folder first, then put it in place at once."""
    from lieid_casadi.cli.compare import save_figure
    from lieid_casadi.exporters.c_export import export_c
    from lieid_casadi.report import diagnosis_report

    fresh = folder.with_name(f".{folder.name}.new")
    shutil.rmtree(fresh, ignore_errors=True)
    fresh.mkdir(parents=True)
    (fresh / MARK).write_text("Made by lieid demo, which replaces this folder.\n")
    demo.excitation.save(fresh / "excitation")
    demo.train.save(fresh / "train.csv.gz")
    demo.test.save(fresh / "test.csv.gz")
    demo.fit.save(fresh / "fit.json")
    demo.better.save(fresh / "better.json")
    save_figure(str(fresh / "comparison.png"), demo.comparison.plot())
    save_figure(str(fresh / "errors.png"), demo.comparison.plot_errors())
    save_figure(str(fresh / "waterfall.png"), demo.diagnosis.plot())
    report = diagnosis_report(demo.diagnosis, demo.better_comparison)
    (fresh / "report.html").write_text(report, encoding="utf-8")
    export_c(demo.better, fresh / "c")
    if folder.exists():
        shutil.rmtree(folder)
    fresh.replace(folder)


def content(demo: Demo) -> dict[str, Any]:
    """Return the demo's numbers for machines."""
    return {
        "excitation": demo.excitation.to_dict(),
        "before": {"effects": demo.fit.model.effects, **demo.comparison.to_dict()},
        "diagnosis": demo.diagnosis.to_dict(),
        "after": {"effects": demo.better.model.effects, **demo.better_comparison.to_dict()},
    }


def show(demo: Demo, folder: Path) -> None:
    """Print the story: the motion, the verdict, the error per joint before and after."""
    before, after = demo.comparison, demo.better_comparison
    output.say(
        f"Excitation: condition number {demo.excitation.condition_number:.3g}, "
        f"{demo.excitation.duration:.0f} s."
    )
    output.say(demo.diagnosis.sentence)
    rows: list[list[object]] = [
        [
            f"{j + 1} {name}",
            float(before.rms_moving[j]),
            float(after.rms_moving[j]),
            float(demo.diagnosis.noise_floor[j]),
            float(after.torque_rms[j]),
        ]
        for j, name in enumerate(before.joint_names)
    ]
    output.table(
        "RMS error on a run that was not fitted, joints in motion, N·m",
        ["joint", "+".join(demo.fit.model.effects), "diagnosed", "noise floor", "torque itself"],
        rows,
    )
    output.say(
        f"{folder}/report.html tells it with pictures; excitation, recordings, fits and C code "
        "for a controller are beside it."
    )
