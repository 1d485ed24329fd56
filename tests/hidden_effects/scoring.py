"""Diagnose a case, seeing recordings and robot only, and score what was said."""

import time

import numpy as np
from cases import EFFECTS, record
from scipy.stats import beta

import lieid_casadi as lieid
from lieid_casadi.diagnosis import diagnose


def run(case):
    """Return one row of the table, or None if the case cannot be had."""
    recorded = record(case)
    if recorded is None:
        return None
    start = time.perf_counter()
    model = lieid.Model(recorded.robot, EFFECTS)
    if case.kind == "changed":
        found = diagnose(lieid.identify(model, recorded.train), recorded.test)
    else:
        found = diagnose(model, recorded.train, recorded.test)
    seconds = time.perf_counter() - start
    row = case.to_dict() | score(found.to_dict(), recorded.truth, case.kind)
    return row | {"size_found": recorded.size, "seconds": round(seconds, 2)}


def score(said, truth, kind):
    """Return right, in_set, extra and what was said; joints from 1 in what was said."""
    steps = [(s["effect"], tuple(j - 1 for j in s["joints"])) for s in said["steps"]]
    sets = [
        {steps[k]}
        | {(r["effect"], tuple(j - 1 for j in r["joints"])) for r in s["indistinguishable"]}
        for k, s in enumerate(said["steps"])
    ]
    text = [f"{name}:{'<'.join(str(j + 1) for j in joints)}" for name, joints in steps]
    row = {"said": text, "verdict": said["verdict"], "rejected": said["rejected"][:3]}
    row["unexplained"] = said["unexplained"][:2]
    if kind == "foreign":
        joint = truth[0][1][0] + 1
        told = said["unexplained"]
        row["right"] = not steps and bool(told) and told[0]["joint"] == joint
        row["in_set"] = row["right"]
        row["extra"] = len(steps)
        return row
    wanted = [t for t in truth if t[0] != "foreign"]
    if not wanted:
        row["right"] = row["in_set"] = said["verdict"] == "sufficient" and not steps
        row["extra"] = len(steps)
        return row
    if len(wanted) == 1:
        row["right"] = bool(steps) and steps[0] == wanted[0] and len(steps) == 1
        row["in_set"] = bool(steps) and wanted[0] in sets[0] and len(steps) == 1
    else:
        row["right"] = set(steps) == set(wanted)
        row["in_set"] = len(steps) == len(wanted) and all(any(w in s for s in sets) for w in wanted)
    row["extra"] = len([s for s in steps if s not in wanted])
    return row


def interval(hits, total, level=0.95):
    """Return the Clopper-Pearson interval of a rate."""
    tail = (1.0 - level) / 2.0
    low = 0.0 if hits == 0 else float(beta.ppf(tail, hits, total - hits + 1))
    high = 1.0 if hits == total else float(beta.ppf(1.0 - tail, hits + 1, total - hits))
    return low, high


def table(rows):
    """Return lines: rate by kind, effect and size, with intervals."""
    groups = {}
    for row in rows:
        name = "+".join(row["names"]) if row["kind"] in ("single", "changed") else ""
        size = row["size"] if row["kind"] != "none" else 0.0
        groups.setdefault((row["kind"], name or "all", size), []).append(row)
        if row["kind"] in ("single", "changed"):
            groups.setdefault((row["kind"], "ALL", size), []).append(row)
    lines = [f"{'kind':9}{'effect':24}{'size':>5} {'right':>9} {'95 % interval':>15} {'in set':>7}"]
    for (kind, name, size), members in sorted(groups.items()):
        hits, total = sum(r["right"] for r in members), len(members)
        low, high = interval(hits, total)
        inside = sum(r["in_set"] for r in members)
        lines.append(
            f"{kind:9}{name:24}{size:5.1f} {hits:4}/{total:<4} {low:6.2f} – {high:4.2f}   "
            f"{inside:4}/{total}"
        )
    seconds = [r["seconds"] for r in rows]
    lines.append(f"seconds: median {np.median(seconds):.1f}, most {max(seconds):.1f}")
    return lines
