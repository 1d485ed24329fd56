"""The benchmark of hidden effects: ``python tests/hidden_effects/run.py [--jobs N] …``.

Cases with an even draw are for setting thresholds (``--half tune``); those with an odd draw are run
once, for the published table (``--half sealed``; with ``--skip K``, those after the first K of a
shuffle). Every case is drawn from its name, diagnosed from its files alone, and scored. Results are
kept in a JSON Lines file; an interrupted run continues with the cases that this version of the code
has not diagnosed. ``--quick`` runs about 30 cases of the tune half, of all kinds, whose files are
kept, so that a second run takes the time of the diagnoses alone.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import os
import sys
import warnings
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from multiprocessing import get_context
from pathlib import Path
from typing import Any

os.environ.setdefault("OMP_NUM_THREADS", "1")
HERE = Path(__file__).resolve().parent
sys.path[:0] = [str(HERE.parent), str(HERE.parents[1])]

from hidden_effects.case_setup import Case  # noqa: E402
from hidden_effects.schedule import HALVES, KINDS, chosen, quick  # noqa: E402
from hidden_effects.score import run_case  # noqa: E402
from hidden_effects.table import confusion_picture, markdown, show  # noqa: E402

#: Packages whose code determines the results.
PACKAGES = (
    "comparison",
    "compiled",
    "diagnosis",
    "dynamics",
    "effects",
    "expressions",
    "identification",
    "model",
    "plant",
    "recording",
    "robot",
)


#: Those of them that generate the cases.
GENERATING = ("plant", "recording", "robot")


def fingerprint(packages: Sequence[str] = PACKAGES) -> str:
    """Return a hash of the code that generates and diagnoses cases."""
    package = HERE.parents[1] / "lieid_casadi"
    apart = ("run", "table", "schedule", *(() if packages == PACKAGES else ("score",)))
    files = sorted(
        [
            f
            for f in package.rglob("*.py")
            if f.relative_to(package).parts[0].removesuffix(".py") in packages
        ]
        + [f for f in HERE.glob("*.py") if f.stem not in apart]
    )
    content = hashlib.sha256()
    for file in files:
        if not file.name.startswith("test_"):
            content.update(file.read_bytes())
    return content.hexdigest()[:12]


def work(name: str, true_model: bool, by_command: bool, cache: Path | None) -> dict[str, Any]:
    """Run one case, in a separate process."""
    warnings.simplefilter("ignore")
    return run_case(Case.parse(name), true_model=true_model, by_command=by_command, cache=cache)


def earlier_results(path: Path, code: str | None) -> dict[str, dict[str, Any]]:
    """Return the results in a file by case, of one version of the code or (None) of any."""
    if not path.exists():
        return {}
    rows = [json.loads(line) for line in path.read_text("utf-8").splitlines() if line.strip()]
    return {row["case"]: row for row in rows if code is None or row.get("code") == code}


def arguments() -> argparse.Namespace:
    """Return the options of the command line."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("--jobs", type=int, default=max(1, (os.cpu_count() or 2) - 1))
    parser.add_argument(
        "--half",
        choices=HALVES,
        default="tune",
        help="thresholds are set on 'tune' only; 'sealed' is run once for the published table",
    )
    parser.add_argument("--modes", nargs="+", choices=("missing", "changed"), default=[])
    parser.add_argument("--kinds", nargs="+", choices=KINDS, default=[])
    parser.add_argument("--effects", nargs="+", default=[], help="of single and foreign cases")
    parser.add_argument("--sizes", nargs="+", type=float, default=[], help="5 2 1 0.5")
    parser.add_argument(
        "--skip", type=int, default=0, metavar="K", help="leave out the first K of a fixed shuffle"
    )
    parser.add_argument("--count", type=int, metavar="K", help="the first K of those that follow")
    parser.add_argument("--seed", type=int, default=0, help="of the shuffle")
    parser.add_argument(
        "--series", nargs="+", type=int, choices=(1, 2), default=[2],
        help="1: draws below 100; 2 (default): noise correlated over up to 1 s, more effects",
    )  # fmt: skip
    parser.add_argument("--quick", action="store_true", help="about 30 cases of the tune half")
    parser.add_argument(
        "--cache", type=Path, metavar="DIR", help="keep the files of the cases for later runs"
    )
    parser.add_argument(
        "--case", nargs="+", default=[], metavar="NAME", help="run these cases only"
    )
    parser.add_argument("--keep", type=Path, metavar="DIR", help="with one --case: keep its files")
    parser.add_argument("--results", type=Path, default=Path("build/hidden_effects.jsonl"))
    parser.add_argument("--any-code", action="store_true", help="use results of other versions too")
    parser.add_argument(
        "--table-only", action="store_true", help="print the table of earlier results"
    )
    parser.add_argument(
        "--no-true-model", action="store_true", help="do not fit the true model for comparison"
    )
    parser.add_argument("--by-command", action="store_true", help="through the command line")
    parser.add_argument("--markdown", action="store_true", help="print the first table as Markdown")
    parser.add_argument("--json", type=Path, metavar="FILE", help="all results")
    parser.add_argument("--picture", type=Path, metavar="PNG", help="confusion matrix")
    return parser.parse_args()


def main() -> int:
    """Run the requested cases and print the table."""
    args = arguments()
    if args.quick:
        args.cache = args.cache or Path("build/hidden_effects_cases")
        wanted = quick()
    elif args.case:
        wanted = [Case.parse(name) for name in args.case]
    else:
        wanted = chosen(
            half=args.half, modes=args.modes, kinds=args.kinds, effects=args.effects,
            sizes=args.sizes, series=args.series, seed=args.seed, skip=args.skip,
            count=args.count,
        )  # fmt: skip
    if args.keep is not None:
        result = run_case(wanted[0], true_model=not args.no_true_model, keep=args.keep)
        sys.stdout.write(json.dumps(result, indent=1) + "\n")
        return 0
    code = None if args.any_code or args.table_only else fingerprint()
    done = earlier_results(args.results, code)
    todo = [] if args.table_only else [case for case in wanted if case.name not in done]
    done |= _run(todo, args, code or fingerprint())
    rows = [done[case.name] for case in wanted if case.name in done]
    scored = [row for row in rows if "skipped" not in row]
    if args.markdown:
        sys.stdout.write(markdown(scored))
    else:
        show(scored)
    if len(scored) < len(rows):
        skipped = [row["case"] for row in rows if "skipped" in row]
        sys.stdout.write(f"{len(skipped)} cases could not be generated: {', '.join(skipped)}\n")
    if args.json is not None:
        args.json.write_text(json.dumps(rows, indent=1) + "\n", encoding="utf-8")
    if args.picture is not None:
        confusion_picture(scored, args.picture)
    return 0


def _run(todo: list[Case], args: argparse.Namespace, code: str) -> dict[str, dict[str, Any]]:
    found: dict[str, dict[str, Any]] = {}
    if not todo:
        return found
    args.results.parent.mkdir(parents=True, exist_ok=True)
    with (
        args.results.open("a", encoding="utf-8") as out,
        ProcessPoolExecutor(args.jobs, mp_context=get_context("spawn")) as pool,
    ):
        cache = args.cache and args.cache / fingerprint(GENERATING)
        jobs = [
            pool.submit(work, c.name, not args.no_true_model, args.by_command, cache) for c in todo
        ]
        for k, job in enumerate(as_completed(jobs), start=1):
            row = job.result() | {"code": code}
            found[row["case"]] = row
            out.write(json.dumps(row) + "\n")
            out.flush()
            sys.stderr.write(f"[{k}/{len(jobs)}] {_line(row)}\n")
    return found


def _line(row: dict[str, Any]) -> str:
    if "skipped" in row:
        return f"{row['case']}: could not be generated"
    mark = "right" if row["right"] else "right in set" if row.get("right_in_set") else "WRONG"
    mark += ", NAMED WRONGLY" if row["named_wrongly"] else ""
    steps = ", ".join(map(_label, row["steps"]))
    rest = "; ".join(f"{u['joint']}({','.join(u['depends_on'])})" for u in row["unexplained"])
    truth = ", ".join(
        f"{e['effect']}:{'<'.join(map(str, e['joints']))} ({e['deviations']} s.d.)"
        for e in row["truth"]
    )
    ratio = row.get("rms_ratio") or row.get("plain_ratio")
    return (
        f"{row['case']}: {mark}: {row.get('error') or row['verdict']}: {steps or 'no step'}"
        + (f"; unexplained {rest}" if rest else "")
        + (f" | hidden {truth}" if truth else "")
        + (f" | RMS ratio {ratio:.2f}" if ratio else "")
        + f" | {row.get('seconds', '–')} s"
    )


def _label(step: dict[str, Any]) -> str:
    signals = f"({','.join(step['depends_on'])})" if "depends_on" in step else ""
    rivals = f" or {len(step['rivals'])} more" if step["status"] == "one_of" else ""
    return f"{step['effect']}{signals}:{'<'.join(map(str, step['joints']))}{rivals}"


if __name__ == "__main__":
    sys.exit(main())
