"""Run the diagnosis on the files of a case, then compare its result with the truth."""

from __future__ import annotations

import json
import shutil
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from hidden_effects.case_setup import Case
from hidden_effects.generator import Unreachable, write

Named = tuple[str, tuple[int, ...]]  # effect and joints from 1
Step = dict[str, Any]
PLAIN = ["coulomb", "viscous", "offset"]


def files_of(case: Case, folder: Path, cache: Path | None) -> dict[str, Any]:
    """Write the files of a case into a folder, or copy earlier ones; return the truth."""
    if cache is None:
        return write(case, folder)
    stored = cache / case.name
    if not (stored / "truth.json").exists():
        truth = write(case, stored / "files")
        (stored / "truth.json").write_text(json.dumps(truth), "utf-8")
    shutil.copytree(stored / "files", folder, dirs_exist_ok=True)
    return dict(json.loads((stored / "truth.json").read_text("utf-8")))


def run_diagnosis(folder: Path, options: Any = None) -> tuple[dict[str, Any], Any]:
    """Return the result of ``diagnose`` for the files of a folder, and the last fit."""
    from lieid_casadi import Model, Recording, Robot, identify
    from lieid_casadi.diagnosis import diagnose

    model = Model(Robot.load(_robot(folder)), effects=PLAIN)
    if (folder / "before.csv").exists():
        fit = identify(model, Recording.load(folder / "before.csv"))
        diagnosis = diagnose(fit, Recording.load(folder / "after.csv"), options=options)
    else:
        train, tests = (list(map(Recording.load, files)) for files in recordings(folder))
        diagnosis = diagnose(model, train, *tests, options=options)
    return json.loads(json.dumps(diagnosis.to_dict())), diagnosis.fit


def run_command(folder: Path) -> tuple[dict[str, Any], Any]:
    """Return the result of ``lieid diagnose`` for the files of a folder, and the last fit."""
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
    case: Case,
    *,
    true_model: bool = True,
    by_command: bool = False,
    keep: Path | None = None,
    cache: Path | None = None,
) -> dict[str, Any]:
    """Generate a case, diagnose it, and return the score; ``keep`` is a folder for its files."""
    with tempfile.TemporaryDirectory(prefix="case") as scratch:
        folder = Path(scratch) / "files" if keep is None else keep
        try:
            truth = files_of(case, folder, cache)
        except Unreachable as problem:
            return {"case": case.name, "skipped": str(problem)}
        begin = time.process_time()
        try:
            found, fit = (run_command if by_command else run_diagnosis)(folder)
        except Exception as problem:  # noqa: BLE001 - every error counts as a failure
            return score_result(case, truth, None) | {
                "error": f"{type(problem).__name__}: {problem}"
            }
        seconds = time.process_time() - begin
        result = score_result(case, truth, found) | {"seconds": round(seconds, 2)}
        if true_model and not case.changed and case.kind != "world":
            result |= errors_against_other_fits(case, folder, truth, fit)
        return result


def errors_against_other_fits(
    case: Case, folder: Path, truth: dict[str, Any], fit: Any
) -> dict[str, Any]:
    """Return the RMS of the diagnosed model relative to that of other fits, of an unseen recording.

    ``rms_ratio`` is relative to a fit of the true model (of the plain model, where nothing is
    hidden), the largest of the affected joints; ``plain_ratio`` relative to the plain model, where
    the library does not have what is hidden. Both are of samples in motion, of one filter.
    """
    from lieid_casadi import LieidError, Model, Recording, Robot, compare, identify

    train = list(map(Recording.load, recordings(folder)[0]))
    (test,) = (Recording.load(f) for f in folder.glob("*.csv") if f.stem in ("test", "unseen"))
    outside = case.kind in ("foreign", "form")
    added = [] if outside else [_spec(e) for e in truth["effects"]]
    try:
        model = Model(Robot.load(_robot(folder)), effects=[*PLAIN, *added])
        expected = compare(identify(model, train, processing=fit.processing), test).rms_moving
    except LieidError:
        return {}
    ratio = compare(fit, test).rms_moving / expected
    joints = [e["joint"] - 1 for e in truth["effects"]] or range(len(ratio))
    return {"plain_ratio" if outside else "rms_ratio": float(np.max([ratio[j] for j in joints]))}


def _spec(effect: dict[str, Any]) -> str:
    if not effect["joints"]:
        return str(effect["effect"])
    return f"{effect['effect']}:{'<'.join(map(str, effect['joints']))}"


def score_result(case: Case, truth: dict[str, Any], found: dict[str, Any] | None) -> dict[str, Any]:
    """Return the score of a result; None stands for a failure.

    Of every kind: ``right`` (the entry that the table counts first) and ``named_wrongly`` (a step
    of status ``named`` that is not there). A step without a status, of an older version, is
    ``one_of`` where it lists rivals, else ``named``.
    """
    steps = [] if found is None else [_step(s) for s in found["steps"]]
    unexplained = [] if found is None else found["unexplained"]
    verdict = None if found is None else found["verdict"]
    result = {
        "case": case.name,
        **{key: truth.get(key) for key in
           ("mode", "arm", "simulated", "duration", "correlation_time", "correlated_part")},
        "kind": case.kind,
        "truth": [
            {key: e.get(key) for key in
             ("effect", "joints", "target", "size", "deviations", "left_part", "joint", "signals",
              "accepted", "nearest", "nearest_part")}
            for e in truth["effects"]
        ],
        "completed": found is not None,
        "verdict": verdict,
        "steps": steps,
        "unexplained": [
            {"joint": u["joint"], "fraction": round(u["fraction"], 3),
             "depends_on": u["depends_on"]}
            for u in unexplained
        ],
        "cutoff": None if found is None else found.get("cutoff"),
    }  # fmt: skip
    if case.kind in ("none", "correlated"):
        points = _empty_points(result)
    elif case.kind == "world":
        points = _world_points(truth["allowed"], result)
    elif case.kind in ("foreign", "form"):
        points = _outside_points(case, truth["effects"][0], result)
    else:
        points = _library_points([_named(e) for e in truth["effects"]], result)
    if found is None:
        points = dict.fromkeys(points, False)
    return result | points


def _step(step: Step) -> Step:
    rivals = [[*_named(r)] for r in step["indistinguishable"]]
    shown = {
        "effect": _named(step)[0],
        "joints": list(step["joints"]),
        "status": step.get("status") or ("one_of" if rivals else "named"),
        "rivals": rivals,
        "group": step.get("group"),
    }
    if shown["effect"] == "smooth":
        signals = step.get("depends_on") or step["effect"].partition("/")[2].split(".")
        own = step["joints"][0] if step["joints"] else ""
        shown["depends_on"] = [
            s if s == "t" or s[-1:].isdigit() else f"{s}{own}" for s in signals if s
        ]
    for key in ("fall", "selected"):
        if step.get(key) is not None:
            shown[key] = step[key]
    return shown


def _named(entry: dict[str, Any]) -> Named:
    return str(entry["effect"]).split("/")[0], tuple(entry["joints"])


def _stated(step: Step) -> list[Named]:
    """Return the effects that a step states to be there, or one of them to be there."""
    return [_named(step), *((str(name), tuple(joints)) for name, joints in step["rivals"])]


def _has_status(steps: list[Step], *statuses: str) -> list[Step]:
    return [step for step in steps if step["status"] in statuses]


def _empty_points(result: dict[str, Any]) -> dict[str, bool]:
    names = bool(_has_status(result["steps"], "named", "one_of"))
    return {
        "right": not result["steps"] and result["verdict"] == "sufficient",
        "name_or_shape": bool(result["steps"]),
        "name": names,
        "named_wrongly": bool(_has_status(result["steps"], "named")),
    }


def _world_points(allowed: list[list[Any]], result: dict[str, Any]) -> dict[str, bool]:
    """A name that does not follow from the violated assumption is wrong; a shape is not."""

    def follows(step: Step) -> bool:
        return any(
            name == allowed_name and tuple(joints) in ((), own)
            for name, own in _stated(step)
            for allowed_name, joints in allowed
        )

    wrong = [s for s in result["steps"] if s["status"] != "shape" and not follows(s)]
    return {"right": not wrong, "named_wrongly": bool(_has_status(wrong, "named"))}


def _library_points(wanted: list[Named], result: dict[str, Any]) -> dict[str, bool]:
    steps = result["steps"]
    first = steps[0] if steps else None
    sets = first is not None and bool(set(_stated(first)) & set(wanted))
    within = all(any(w in _stated(s) for s in steps) for w in wanted)
    extra = [s for s in steps if not set(_stated(s)) & set(wanted)]
    alone = len(steps) == len(wanted) and not extra
    names = [_named(s) for s in steps]
    return {
        "right": alone and sorted(names) == sorted(wanted),
        "right_in_set": alone and within,
        "right_first": first is not None and names[0] in wanted,
        "right_first_in_set": sets,
        "named_wrongly": bool(_has_status(extra, "named")),
        "set_wrong": bool(_has_status(extra, "one_of")),
    }


def _outside_points(case: Case, effect: dict[str, Any], result: dict[str, Any]) -> dict[str, bool]:
    """Right is a shape (or an unexplained part) of the right signals, or an equivalent effect.

    No effect may be named that is not there: of a form, on another joint; of a foreign effect, any.
    """
    here = tuple(effect["joints"])
    accepted = [(name, here) for name in effect["accepted"]]
    steps = result["steps"]
    parts = [
        (s["joints"][0], s["depends_on"]) for s in steps if s["effect"] == "smooth" and s["joints"]
    ] + [(u["joint"], u["depends_on"]) for u in result["unexplained"]]
    joint, signals = parts[0] if parts else (0, [])
    right_joint = joint == effect["joint"]
    if case.kind == "form":  # several curves have this form: the first signal counts
        described = right_joint and _are_signals(signals[:1], effect["signals"])
    else:
        wanted = effect["signals"]
        described = right_joint and _are_signals(signals[: len(wanted)], wanted, every=True)
    stated = [s for s in steps if s["status"] != "shape"]
    equivalent = any(one in accepted for s in stated for one in _stated(s))
    wrong = [s for s in stated if not set(_stated(s)) & set(accepted)]
    if case.kind == "form":
        wrong = [s for s in wrong if tuple(s["joints"]) != here]
    return {
        "right": not wrong and (equivalent or described),
        "equivalent": equivalent,
        "joint_right": right_joint,
        "signals_right": described,
        "no_wrong_step": not wrong,
        "named_wrongly": bool(_has_status(wrong, "named")),
        "right_first": bool(steps) and _named(steps[0]) in accepted,
    }


def _are_signals(shown: list[str], wanted: list[str], *, every: bool = False) -> bool:
    """Whether the first signals are among those wanted, or all of them; ``a|b`` is either one."""
    found = [any(s in w.split("|") for w in wanted) for s in shown]
    complete = all(any(s in w.split("|") for s in shown) for w in wanted) if every else True
    return bool(found) and all(found) and complete
