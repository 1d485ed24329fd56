"""``lieid demo [-o DIR]``: the whole workflow on a simulated arm, without a robot or data."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import lieid_casadi as lieid
from lieid_casadi.cli import output
from lieid_casadi.cli.options import Args, command
from lieid_casadi.tables import Table, figures, make_table

if TYPE_CHECKING:
    from lieid_casadi.demo import Demo


@command("demo", "the whole workflow on a simulated arm")
def run(args: Args) -> output.Outcome:
    """Run the whole workflow on a simulated arm: from excitation and diagnosis to C code.

    -o/--output DIR: folder = lieid-demo  folder to write
    @FORCE
    --robot ROBOT: input = panda  robot to simulate
    --seed N: seed = 0  random seed
    @JSON
    """
    from lieid_casadi.demo import run_demo

    folder = Path(args.output)
    with output.progress("demo") as report:
        demo = run_demo(lieid.Robot.load(args.robot), seed=args.seed, progress=report)
    return output.Outcome(
        shown(demo, folder),
        json={
            "excitation": demo.excitation.to_dict(),
            "before": {"effects": demo.fit.model.effects, **demo.comparison.to_dict()},
            "diagnosis": demo.diagnosis.to_dict(),
            "after": {"effects": demo.better.model.effects, **demo.better_comparison.to_dict()},
        },
        folder=lambda: write(demo, folder, force=args.force),
    )


def write(demo: Demo, folder: Path, *, force: bool = False) -> None:
    """Write all files of a demo into a folder, as a whole or not at all."""
    from lieid_casadi.output_folder import output_folder
    from lieid_casadi.report import diagnosis_report

    with output_folder(folder, force=force) as fresh:
        demo.excitation.save(fresh / "excitation")
        demo.train.save(fresh / "train.csv.gz")
        demo.test.save(fresh / "test.csv.gz")
        demo.fit.save(fresh / "fit.json")
        demo.better.save(fresh / "better.json")
        for name, figure in (
            ("comparison.png", demo.comparison.plot()),
            ("errors.png", demo.comparison.plot_errors()),
            ("waterfall.png", demo.diagnosis.plot()),
        ):
            figure.savefig(fresh / name, dpi=110)
        report = diagnosis_report(demo.diagnosis, demo.better_comparison)
        (fresh / "report.html").write_bytes(report.encode(errors="replace"))
        lieid.export(demo.better, fresh / "c", to="c")


def shown(demo: Demo, folder: Path) -> tuple[str | Table, ...]:
    """Return the excitation, the verdict, and the error per joint before and after."""
    before, after = demo.comparison, demo.better_comparison
    joints = [f"{j} {name}" for j, name in enumerate(before.joint_names, start=1)]
    numbers = (before.rms_moving, after.rms_moving, after.torque_rms)
    errors = make_table(
        "RMS error on a run that was not fitted, joints in motion, N·m",
        ["joint", "+".join(demo.fit.model.effects), "diagnosed", "measured torque"],
        zip(joints, *(map(figures, x) for x in numbers), strict=True),
    )
    return (
        f"Excitation: condition number {demo.excitation.condition_number:.3g}, "
        f"{demo.excitation.duration:.0f} s.",
        demo.diagnosis.sentence,
        demo.diagnosis.summary,
        errors,
        f"The report is {folder}/report.html; {folder} also has the excitation, recordings, fits "
        "and C code.",
    )
