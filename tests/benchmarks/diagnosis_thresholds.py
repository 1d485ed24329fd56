"""How the goals of the diagnosis move when ten of its thresholds are halved and doubled.

    python tests/benchmarks/diagnosis_thresholds.py [--cases 60] [--thresholds NAME…] [--jobs N]

Every case of the benchmark of hidden effects is a recording of a simulated arm; the cases are the
first of the fixed order of single effects at 5, 2 and 1 times the noise, of complete models, and of
foreign effects, in the proportions 3:2:1. The table has the correct results of each kind with the
default options and with each threshold halved and doubled. Results are kept in a JSON Lines file,
so that an interrupted run continues.
"""

import argparse
import json
import os
import sys
import tempfile
import warnings
from collections import Counter
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import fields, replace
from multiprocessing import get_context
from pathlib import Path

os.environ.setdefault("OMP_NUM_THREADS", "1")
HERE = Path(__file__).resolve().parent
sys.path[:0] = [str(HERE.parent), str(HERE.parents[1])]

from hidden_effects.generator import Unreachable, write  # noqa: E402
from hidden_effects.schedule import chosen  # noqa: E402
from hidden_effects.score import recordings, score_result  # noqa: E402

import lieid_casadi as lieid  # noqa: E402
from lieid_casadi.diagnosis import DiagnosisOptions  # noqa: E402

THRESHOLDS = (
    "significance",
    "worth",
    "held_out_deviations",
    "held_out_duration",
    "least_own_part",
    "least_support",
    "least_gain_with_smooth",
    "least_residual_part",
    "residual_significance",
    "rival_deviations",
)
FACTORS = (0.5, 2.0)


def cases(count):
    """Return the cases: of every 6, 3 single effects, 2 complete models and 1 foreign effect."""
    single = chosen(
        modes=["missing"], kinds=["single"], sizes=[5.0, 2.0, 1.0], series=[1], count=count // 2
    )
    nothing = chosen(modes=["missing"], kinds=["none"], series=[1], count=count // 3)
    foreign = chosen(
        modes=["missing"], kinds=["foreign"], series=[1], count=count - len(single) - len(nothing)
    )
    return [
        case
        for k, last in enumerate(foreign)
        for case in (*single[3 * k : 3 * k + 3], *nothing[2 * k : 2 * k + 2], last)
    ]


def diagnosed(folder, options):
    robot = lieid.Robot.load(next(iter(sorted(folder.glob("robot.*")))))
    model = lieid.Model(robot, "coulomb,viscous,offset")
    train, _ = recordings(folder)  # the test chooses nothing
    return lieid.diagnose(model, [lieid.Recording.load(file) for file in train], options=options)


def diagnose_case(case, variants):
    """Return one row for each variant; none where the effect cannot reach the case's size."""
    warnings.simplefilter("ignore")
    rows = []
    if not variants:
        return rows
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch)
        try:
            truth = write(case, folder)
        except Unreachable:
            return rows
        for name, options in variants.items():
            found = json.loads(json.dumps(diagnosed(folder, options).to_dict()))
            score = score_result(case, truth, found)
            named = bool(score["extra"]) if case.kind == "single" else bool(found["steps"])
            rows.append(
                {
                    "case": case.name, "kind": case.kind, "variant": name,
                    "right": score["right"], "wrong_name": named,
                }
            )  # fmt: skip
    return rows


def run(wanted, variants, path, jobs):
    """Run all variants of all cases that the file does not have, and return the rows."""
    rows = []
    if path.exists():
        rows = [json.loads(line) for line in path.read_text("utf-8").splitlines()]
    done = {(row["case"], row["variant"]) for row in rows}
    path.parent.mkdir(parents=True, exist_ok=True)
    with (
        path.open("a", encoding="utf-8") as out,
        ProcessPoolExecutor(jobs, get_context("spawn")) as pool,
    ):
        tasks = [
            pool.submit(
                diagnose_case,
                case,
                {n: o for n, o in variants.items() if (case.name, n) not in done},
            )
            for case in wanted
        ]
        for task in as_completed(tasks):
            rows += task.result()
            out.writelines(json.dumps(row) + "\n" for row in task.result())
            out.flush()
    return rows


def table(rows, variants):
    """Return the table as Markdown; only cases that all variants have are counted."""
    counts = Counter(row["case"] for row in rows if row["variant"] in variants)
    complete = {case for case, count in counts.items() if count == len(variants)}
    lines = [
        "| option | single right | nothing: sufficient | foreign right | wrong names |",
        "| --- | --- | --- | --- | --- |",
    ]
    for name in variants:
        own = [r for r in rows if r["variant"] == name and r["case"] in complete]
        cells = []
        for kind in ("single", "none", "foreign"):
            of_kind = [r["right"] for r in own if r["kind"] == kind]
            cells.append(f"{sum(of_kind)}/{len(of_kind)}")
        wrong = sum(r["wrong_name"] for r in own)
        lines.append(f"| {name} | {' | '.join(cells)} | {wrong}/{len(own)} |")
    return "\n".join(lines)


def main():
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("--cases", type=int, default=60)
    parser.add_argument("--thresholds", nargs="+", default=list(THRESHOLDS), metavar="NAME")
    parser.add_argument("--results", type=Path, default=Path("build/diagnosis_thresholds.jsonl"))
    parser.add_argument("--jobs", type=int, default=1)
    args = parser.parse_args()
    default = DiagnosisOptions()
    values = {field.name: getattr(default, field.name) for field in fields(default)}
    variants = {"default": default}
    for name in args.thresholds:
        for factor in FACTORS:
            value = factor * values[name]
            variants[f"`{name}` = {value:g}"] = replace(default, **{name: value})
    rows = run(cases(args.cases), variants, args.results, args.jobs)
    sys.stdout.write(table(rows, variants) + "\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
