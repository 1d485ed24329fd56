"""How the results of the diagnosis move when each of its options is halved and doubled.

    python tests/benchmarks/diagnosis_thresholds.py [--mode changed] [--cases 30] [--options NAME…]

The cases are those of the tune half of the benchmark of hidden effects, in the proportions of
single effects, arms without hidden effects, and effects outside the library of 3:2:1: effects that
a model lacks or, with ``--mode changed``, that changed since a fit. The table has
the correct results of each kind with the default options and with each numeric field of
``DiagnosisOptions`` halved and doubled, and how many cases have other steps, and another verdict,
than with the defaults. Results are kept in a JSON Lines file, so that an interrupted run continues.
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

from hidden_effects.generator import Unreachable  # noqa: E402
from hidden_effects.run import GENERATING, fingerprint  # noqa: E402
from hidden_effects.schedule import chosen, varied  # noqa: E402
from hidden_effects.score import files_of, run_diagnosis, score_result  # noqa: E402

from lieid_casadi.diagnosis import DiagnosisOptions  # noqa: E402

FACTORS = (0.5, 2.0)
KINDS = {"single": ("single",), "nothing": ("none", "correlated"), "outside": ("foreign", "form")}


def numeric_options():
    """Return the numeric options by name."""
    values = {
        field.name: getattr(DiagnosisOptions(), field.name) for field in fields(DiagnosisOptions)
    }
    return {
        n: v for n, v in values.items() if isinstance(v, int | float) and not isinstance(v, bool)
    }


def scaled(value, factor):
    """Return a value times a factor; counts stay whole and positive."""
    return max(1, round(value * factor)) if isinstance(value, int) else value * factor


def cases(count, mode):
    """Return the cases of a mode, those of all kinds mixed."""
    found = []
    for kinds, share in zip(KINDS.values(), (3, 2, 1), strict=True):
        own = chosen(modes=[mode], kinds=kinds, sizes=[5.0, 2.0, 1.0, 0.0], series=[2])
        part = count * share // 6
        found += [(case, (k + 0.5) / part) for k, case in enumerate(varied(own)[:part])]
    return [case for case, _ in sorted(found, key=lambda pair: pair[1])]


def diagnose_case(case, variants, cache):
    """Return one row for each variant; none where the effect cannot reach the case's size."""
    warnings.simplefilter("ignore")
    rows = []
    if not variants:
        return rows
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch)
        try:
            truth = files_of(case, folder, cache)
        except Unreachable:
            return rows
        for name, options in variants.items():
            found, _ = run_diagnosis(folder, options)
            score = score_result(case, truth, found)
            right = {
                "single": score.get("right_first_in_set"),
                "nothing": not score.get("name_or_shape"),
                "outside": score["right"],
            }
            kind = next(name for name, kinds in KINDS.items() if case.kind in kinds)
            rows.append(
                {
                    "case": case.name, "kind": kind, "variant": name, "right": right[kind],
                    "named_wrongly": score["named_wrongly"],
                    "verdict": score["verdict"],
                    "result": [[s["effect"], s["joints"], s["status"]] for s in score["steps"]],
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
    cache = Path("build/hidden_effects_cases") / fingerprint(GENERATING)
    with (
        path.open("a", encoding="utf-8") as out,
        ProcessPoolExecutor(jobs, get_context("spawn")) as pool,
    ):
        tasks = [
            pool.submit(
                diagnose_case,
                case,
                {n: o for n, o in variants.items() if (case.name, n) not in done},
                cache,
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
    default = {r["case"]: r for r in rows if r["variant"] == "default"}
    lines = [
        "| option | single right first or in the set | nothing hidden: no name, no shape "
        "| outside the library right | named wrongly | steps that differ | verdicts |",
        "| --- " * 7 + "|",
    ]
    for name in variants:
        own = [r for r in rows if r["variant"] == name and r["case"] in complete]
        cells = []
        for kind in KINDS:
            of_kind = [r["right"] for r in own if r["kind"] == kind]
            cells.append(f"{sum(of_kind)}/{len(of_kind)}")
        cells.append(f"{sum(r['named_wrongly'] for r in own)}/{len(own)}")
        cells += [
            str(sum(r[key] != default[r["case"]][key] for r in own))
            for key in ("result", "verdict")
        ]
        lines.append(f"| {name} | {' | '.join(cells)} |")
    return "\n".join(lines)


def main():
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    options = numeric_options()
    parser.add_argument("--mode", choices=("missing", "changed"), default="missing")
    parser.add_argument("--cases", type=int, default=30)
    parser.add_argument("--options", nargs="+", choices=options, default=list(options))
    parser.add_argument("--results", type=Path, default=Path("build/diagnosis_thresholds.jsonl"))
    parser.add_argument("--jobs", type=int, default=1)
    args = parser.parse_args()
    variants = {"default": DiagnosisOptions()}
    for name in args.options:
        for factor in FACTORS:
            value = scaled(options[name], factor)
            if value != options[name]:
                variants[f"`{name}` = {value:g}"] = replace(DiagnosisOptions(), **{name: value})
    rows = run(cases(args.cases, args.mode), variants, args.results, args.jobs)
    sys.stdout.write(table(rows, variants) + "\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
