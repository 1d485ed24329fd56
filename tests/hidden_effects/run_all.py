"""The whole benchmark: ``python tests/hidden_effects/run_all.py -o results.jsonl --cores 2``.

Rows that are in the file already are not run again.
"""

import argparse
import json
import sys
from multiprocessing import get_context
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parent))

from cases import Case

from lieid_casadi import plant

ARMS = {"panda": 7, "six_axes": 6, "two_link": 2}
IN_FIT = tuple(n for n in plant.HIDDEN_EFFECT_NAMES if n != "payload")
SIZES = (5.0, 2.0, 1.0, 0.5)


def all_cases(draws=4, nothing=200, pairs=30, triples=10, foreign=30, seed=0):
    """Return all cases; joints, arms and seeds are drawn."""
    random = np.random.default_rng(seed)
    cases = []

    def arm_and_joint():
        arm = str(random.choice(list(ARMS)))
        return arm, int(random.integers(ARMS[arm]))

    for size in SIZES:
        for name in IN_FIT:
            for _ in range(draws):
                arm, joint = arm_and_joint()
                seed_ = int(random.integers(1 << 20))
                cases.append(Case("single", arm, (name,), (joint,), size, seed_))
    for k in range(nothing):
        arm, _ = arm_and_joint()
        cases.append(Case("none", arm, (), (), 0.0, int(random.integers(1 << 20)), k % 4 == 0))
    for kind, count, total in (("pair", pairs, 2), ("triple", triples, 3)):
        for _ in range(count):
            arm = str(random.choice(["panda", "six_axes"]))
            names = tuple(str(x) for x in random.choice(IN_FIT, total, replace=False))
            joints = tuple(int(j) for j in random.choice(ARMS[arm], total, replace=False))
            cases.append(Case(kind, arm, names, joints, 3.0, int(random.integers(1 << 20))))
    for _ in range(foreign):
        arm, joint = arm_and_joint()
        cases.append(
            Case("foreign", arm, ("foreign",), (joint,), 3.0, int(random.integers(1 << 20)))
        )
    for name in (*plant.HIDDEN_EFFECT_NAMES, None, None, None, None):
        for _ in range(draws):
            arm, joint = arm_and_joint()
            names, joints = ((), ()) if name is None else ((name,), (joint,))
            cases.append(Case("changed", arm, names, joints, 1.0, int(random.integers(1 << 20))))
    order = np.random.default_rng(1).permutation(len(cases))
    return [cases[k] for k in order]


def _run(case):
    import warnings

    from scoring import run

    warnings.simplefilter("ignore")
    return case, run(case)


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("-o", "--output", default="hidden_effects.jsonl")
    parser.add_argument("--cores", type=int, default=2)
    parser.add_argument("--kinds", nargs="+")
    parser.add_argument("--most", type=int, help="stop after this many")
    parser.add_argument("--draws", type=int, default=4)
    args = parser.parse_args()
    file = Path(args.output)
    rows = [json.loads(line) for line in file.read_text().splitlines()] if file.exists() else []
    done = {(r["kind"], r["arm"], tuple(r["names"]), tuple(r["joints"]), r["size"], r["seed"])
            for r in rows}  # fmt: skip
    cases = [
        c
        for c in all_cases(args.draws)
        if (not args.kinds or c.kind in args.kinds)
        and (c.kind, c.arm, c.names, c.joints, c.size, c.seed) not in done
    ][: args.most]
    with get_context("spawn").Pool(args.cores) as pool, file.open("a") as out:
        for case, row in pool.imap_unordered(_run, cases):
            if row is None:
                print(f"cannot be had: {case}", file=sys.stderr)
                continue
            rows.append(json.loads(json.dumps(row)))
            out.write(json.dumps(row) + "\n")
            out.flush()
    from scoring import table

    print("\n".join(table(rows)))


if __name__ == "__main__":
    main()
