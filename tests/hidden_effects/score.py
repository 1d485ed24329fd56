"""Run the diagnosis on the files of a case, then compare its result with the truth."""

from __future__ import annotations

import json
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from hidden_effects.case_setup import Case
from hidden_effects.generator import Unreachable, write

Named = tuple[str, tuple[int, ...]]  # effect and joints from 1
CLOSE_TO_TRUE_MODEL = 1.05


def run_diagnosis(folder: Path, *, by_command: bool = False) -> tuple[dict[str, Any], Any]:
    """Return the result of ``lieid diagnose`` for the files of a folder, and the last fit."""
    return _by_command(folder) if by_command else _by_python(folder)


def _by_python(folder: Path) -> tuple[dict[str, Any], Any]:
    from lieid_casadi import Model, Recording, Robot, identify
    from lieid_casadi.diagnosis import diagnose

    model = Model(Robot.load(_robot(folder)), effects=["coulomb", "viscous", "offset"])
    if (folder / "before.csv").exists():
        fit = identify(model, Recording.load(folder / "before.csv"))
        diagnosis = diagnose(fit, Recording.load(folder / "after.csv"))
    else:
        train, tests = (list(map(Recording.load, files)) for files in recordings(folder))
        diagnosis = diagnose(model, train, *tests)
    return json.loads(json.dumps(diagnosis.to_dict())), diagnosis.fit


def _by_command(folder: Path) -> tuple[dict[str, Any], Any]:
    from lieid_casadi.cli.main import main
    from lieid_casadi.identification import Fit

    robot, found, fit = _robot(folder), folder / "found.json", folder / "found_fit.json"
    if (folder / "before.csv").exists():
        base = folder / "before.json"
        _run(main, ["identify", robot, folder / "before.csv", "-o", base])
        _run(main, ["diagnose", base, folder / "after.csv", "--json", found, "-o", fit])
    else:
        train, tests = recordings(folder)
        test = ["--test", *tests] if tests else []
        _run(main, ["diagnose", robot, "--train", *train, *test, "--json", found, "-o", fit])
    return json.loads(found.read_text("utf-8")), Fit.load(fit)


def recordings(folder: Path) -> tuple[list[Path], list[Path]]:
    """Return the files for training and, if the case has one, for the test."""
    return sorted(folder.glob("train*.csv")), sorted(folder.glob("test.csv"))


def _run(main: Any, command: Sequence[object]) -> None:
    status = main([str(word) for word in command])
    if status:
        raise RuntimeError(f"lieid {' '.join(map(str, command))}: exit status {status}")


def _robot(folder: Path) -> Path:
    return next(iter(sorted(folder.glob("robot.*"))))


def run_case(
    case: Case, *, true_model: bool = True, by_command: bool = False, keep: Path | None = None
) -> dict[str, Any]:
    """Generate a case, diagnose it, and return the score; ``keep`` is a folder for its files."""
    with tempfile.TemporaryDirectory(prefix="case") as scratch:
        folder = Path(scratch) / "files" if keep is None else keep
        try:
            truth = write(case, folder)
        except Unreachable as problem:
            return {"case": case.name, "skipped": str(problem)}
        begin = time.perf_counter()
        try:
            found, fit = run_diagnosis(folder, by_command=by_command)
        except Exception as problem:  # noqa: BLE001 - every error counts as a failure
            return score_result(case, truth, None) | {
                "error": f"{type(problem).__name__}: {problem}"
            }
        seconds = time.perf_counter() - begin
        result = score_result(case, truth, found) | {"seconds": round(seconds, 2)}
        if true_model and case.kind in ("single", "pair", "triple") and not case.changed:
            result |= {"rms_ratio": rms_against_true_model(folder, truth, fit)}
    return result


def rms_against_true_model(folder: Path, truth: dict[str, Any], fit: Any) -> float | None:
    """Return the RMS on the affected joints relative to that of the true model; the largest.

    Both are of moving samples of a recording that no fit used, through the same filter.
    """
    from lieid_casadi import LieidError, Model, Recording, Robot, compare, identify

    train = list(map(Recording.load, recordings(folder)[0]))
    (test,) = (Recording.load(f) for f in folder.glob("*.csv") if f.stem in ("test", "unseen"))
    specs = ["coulomb", "viscous", "offset", *(_spec(e) for e in truth["effects"])]
    try:
        model = Model(Robot.load(_robot(folder)), effects=specs)
        expected = compare(identify(model, train, processing=fit.processing), test).rms_moving
    except LieidError:
        return None
    ratio = compare(fit, test).rms_moving / expected
    return float(np.max([ratio[e["joint"] - 1] for e in truth["effects"]]))


def _spec(effect: dict[str, Any]) -> str:
    if not effect["joints"]:
        return str(effect["effect"])
    return f"{effect['effect']}:{'<'.join(map(str, effect['joints']))}"


def score_result(case: Case, truth: dict[str, Any], found: dict[str, Any] | None) -> dict[str, Any]:
    """Return the score of a result; None stands for a failure."""
    steps = [] if found is None else found["steps"]
    foreign = case.kind in ("foreign", "form")
    wanted = [] if foreign else [_named(e) for e in truth["effects"]]
    strict, _, _ = _matched(steps, wanted, sets=False)
    within, extra, missed = _matched(steps, wanted, sets=True)
    unexplained = [] if found is None else found["unexplained"]
    result = {
        "case": case.name,
        "mode": truth["mode"],
        "kind": case.kind,
        "arm": truth["arm"],
        "simulated": truth["simulated"],
        "truth": [
            {key: e[key] for key in
             ("effect", "joints", "target", "size", "left_part", "joint", "signals", "accepted",
              "nearest", "nearest_part")}
            for e in truth["effects"]
        ],
        "completed": found is not None,
        "verdict": None if found is None else found["verdict"],
        "steps": [list(_named(step)) for step in steps],
        "rivals": [[list(_named(r)) for r in step["indistinguishable"]] for step in steps],
        "unexplained": [
            {"joint": u["joint"], "fraction": round(u["fraction"], 3),
             "depends_on": u["depends_on"]}
            for u in unexplained
        ],
        "cutoff": None if found is None else found.get("cutoff"),
        "extra": [list(e) for e in extra],
        "missed": [list(e) for e in missed],
    }  # fmt: skip
    return result | _points(case, truth, result, (strict, within))


def _points(
    case: Case, truth: dict[str, Any], result: dict[str, Any], complete: tuple[bool, bool]
) -> dict[str, bool]:
    """Return the entries on which the goals are defined."""
    completed = bool(result["completed"])
    if case.kind == "world":
        names = [_named(step) for step in result_steps(result)]
        wrong = [one for one in names if not _is_allowed(one, truth["allowed"])]
        return {"right": completed and not wrong, "named": bool(names)}
    if case.kind == "form":
        return _form_points(truth["effects"][0], result)
    if case.kind == "none":
        alarm = bool(result["steps"]) or result["verdict"] != "sufficient"
        return {"right": completed and not alarm, "named": bool(result["steps"])}
    if case.kind == "foreign":
        return _foreign_points(truth["effects"][0], result)
    first = result_steps(result)[:1]
    wanted = [_named(e) for e in truth["effects"]]
    return {
        "right": completed and complete[0],
        "right_in_set": completed and complete[1],
        "right_first": completed and bool(first) and _named(first[0]) in wanted,
    }


def result_steps(result: dict[str, Any]) -> list[dict[str, Any]]:
    """Return the steps of a score, as those of a diagnosis."""
    return [{"effect": name, "joints": joints} for name, joints in result["steps"]]


def _is_allowed(named: Named, allowed: list[list[Any]]) -> bool:
    return any(name == named[0] and tuple(joints) in ((), named[1]) for name, joints in allowed)


def _form_points(effect: dict[str, Any], result: dict[str, Any]) -> dict[str, bool]:
    """Return whether the class was named on its joint, or the residual honestly described."""
    here = tuple(effect["joints"])
    accepted = [(name, here) for name in effect["accepted"]]
    names = [_named(step) for step in result_steps(result)]
    rivals = [(str(name), tuple(joints)) for one in result["rivals"] for name, joints in one]
    class_named = any(one in accepted for one in names + rivals)
    others = [one for one in names if one[1] != here]
    first = result["unexplained"][0] if result["unexplained"] else None
    described = (
        not names
        and first is not None
        and first["joint"] == effect["joint"]
        and first["depends_on"][0] in effect["signals"]
    )
    completed = bool(result["completed"])
    return {
        "right": completed and not others and (class_named or described),
        "class_named": completed and class_named,
        "first_named": completed and names[:1] != [] and names[0] in accepted,
    }


def _foreign_points(effect: dict[str, Any], result: dict[str, Any]) -> dict[str, bool]:
    no_step = bool(result["completed"]) and not result["steps"]
    first = result["unexplained"][0] if result["unexplained"] else None
    right_joint = first is not None and first["joint"] == effect["joint"]
    signals = first["depends_on"] if first else []
    all_first = set(signals[: len(effect["signals"])]) == set(effect["signals"])
    return {
        "right": no_step and right_joint and all_first,
        "no_step": no_step,
        "joint_first": right_joint,
        "one_signal_first": right_joint and bool(signals) and signals[0] in effect["signals"],
    }


def _named(entry: dict[str, Any]) -> Named:
    return str(entry["effect"]), tuple(entry["joints"])


def _matched(
    steps: list[dict[str, Any]], wanted: list[Named], *, sets: bool
) -> tuple[bool, list[Named], list[Named]]:
    """Return whether the steps are exactly those wanted, the extra ones, and the missing ones.

    With ``sets`` a step also counts for its rivals.
    """
    open_steps, open_wanted = list(steps), list(wanted)
    for step in steps:
        if _named(step) in open_wanted:
            open_wanted.remove(_named(step))
            open_steps.remove(step)
    if sets:
        for step in list(open_steps):
            rivals = [_named(r) for r in step["indistinguishable"]]
            match = next((w for w in open_wanted if w in rivals), None)
            if match is not None:
                open_wanted.remove(match)
                open_steps.remove(step)
    extra = [_named(step) for step in open_steps]
    return not extra and not open_wanted, extra, open_wanted
