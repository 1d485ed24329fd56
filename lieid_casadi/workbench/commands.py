"""The commands and the Python lines that reproduce the state of a page."""

from __future__ import annotations

import shlex

from lieid_casadi.effects import parse_effects
from lieid_casadi.effects.placement import labels
from lieid_casadi.premises.correction import OPTIONS as CORRECTIONS
from lieid_casadi.workbench.session import ModelStep, Role, Session, WorkbenchInputs, kept_parts


def shell_lines(session: Session, cutoff: float | None = None) -> str:
    """Return ``lieid`` commands that fit the model of the current step and diagnose it.

    ``cutoff`` is that of the fit's filter, Hz; by default each command chooses it.
    """
    inputs, step = session.inputs, _step(session)
    train, test = _paths(inputs, step, "train"), _paths(inputs, step, "test")
    if inputs.mode == "changed":
        words = [inputs.fit, *test, *train, *inputs.words]
        return "\n".join(shlex.join(["lieid", name, *words]) for name in ("compare", "diagnose"))
    options = [*inputs.words, *([] if cutoff is None else ["--cutoff", repr(cutoff)])]
    source = inputs.fit or inputs.robot
    given = [*(["--test", *test] if test else []), "--effects", _effects(step), *options]
    identify = shlex.join(["lieid", "identify", source, *train, *given, "-o", "fit.json"])
    if inputs.fit:  # lieid diagnose FIT looks for changes since the fit
        return identify
    return f"{identify}\n{shlex.join(['lieid', 'diagnose', source, '--train', *train, *given])}"


def python_lines(session: Session, cutoff: float | None = None) -> str:
    """Return Python that makes the fit and the comparison of the current step.

    ``cutoff`` is that of the fit's filter, Hz; by default it is chosen from the data.
    """
    inputs, step = session.inputs, _step(session)
    stated, changed = dict(inputs.options), inputs.mode == "changed"
    lines = ["import lieid_casadi as lieid"]
    if "effects-file" in stated:
        lines += ["import runpy", f"runpy.run_path({stated['effects-file'][0]!r})"]
    lines.append("")
    if changed:
        lines += [f"fit = lieid.Fit.load({inputs.fit!r})", "robot = fit.model.robot"]
    elif inputs.fit:
        lines += [f"robot = lieid.Fit.load({inputs.fit!r}).model.robot"]
    else:
        tip = f", tip={stated['tip'][0]!r}" if "tip" in stated else ""
        lock = f", lock={list(stated['lock'])!r}" if "lock" in stated else ""
        lines += [f"robot = lieid.Robot.load({inputs.robot!r}{tip}{lock})"]
    lines += _drive_lines({name: values[0] for name, values in inputs.options if values})
    lines += _load_lines(inputs)

    def loaded(role: Role) -> str:
        return "[" + ", ".join(f"load({path!r})" for path in _paths(inputs, step, role)) + "]"

    if changed:
        lines += [f"new = {loaded('test')}", "comparison = lieid.compare(fit, new)"]
        return "\n".join([*lines, "diagnosis = lieid.diagnose(fit, new)"])
    filter_ = "" if cutoff is None else f", processing=lieid.Processing(cutoff={cutoff!r})"
    lines += [
        f"model = lieid.Model(robot, {_effects(step)!r})",
        f"train, test = {loaded('train')}, {loaded('test')}",
        f"fit = lieid.identify(model, train{filter_})",
    ]
    if inputs.paths("test"):
        lines += ["comparison = lieid.compare(fit, test)", "print(comparison.rms_moving)"]
        return "\n".join([*lines, f"diagnosis = lieid.diagnose(model, train, test{filter_})"])
    lines += ["print(fit.rms_cv)", f"diagnosis = lieid.diagnose(model, train{filter_})"]
    return "\n".join(lines)


def _drive_lines(stated: dict[str, str]) -> list[str]:
    """Return lines that state the control laws of position-controlled drives."""
    if "servo" in stated:
        names, gains = stated["servo"].split(","), stated.get("damping", "0").split(",")
        count = max(len(names), len(gains))
        pairs = zip(_repeated(names, count), _repeated(gains, count), strict=True)
        laws = [
            f"lieid.servo_drive({name.strip()!r}"
            + (f", derivative={float(d)!r})" if float(d) else ")")
            for name, d in pairs
        ]
    elif "stiffness" in stated:
        unknown = stated["stiffness"] == "unknown"
        stiffness = ["1.0"] if unknown else stated["stiffness"].split(",")
        damping, end = stated.get("damping", "0").split(","), ", relative=True" if unknown else ""
        count = max(len(stiffness), len(damping))
        pairs = zip(_repeated(stiffness, count), _repeated(damping, count), strict=True)
        laws = [f"lieid.Drive(stiffness={float(k)!r}, damping={float(d)!r}{end})" for k, d in pairs]
    else:
        return []
    drives = laws[0] if len(laws) == 1 else f"[{', '.join(laws)}]"
    return [f"robot = robot.with_drives({drives})"]


def _repeated(values: list[str], count: int) -> list[str]:
    return values * count if len(values) == 1 else values


def _load_lines(inputs: WorkbenchInputs) -> list[str]:
    """Return lines that define how recordings are loaded, and apply corrections of premises."""
    stated = {name: values[0] for name, values in inputs.options if values}
    arguments = ["drives=robot.drives", "joint_names=[joint.name for joint in robot.joints]"]
    if "torque-constants" in stated:
        constants = [float(k) for k in stated["torque-constants"].split(",")]
        arguments.append(f"torque_constants={constants!r}")
    given = [name for name in ("units", "calibration", "columns") if name in stated]
    arguments += [f"{name}={stated[name]!r}" for name in given]
    if "calibration" in stated:
        limits = 'robot.limit("position_lower"), robot.limit("position_upper")'
        arguments.append(f"position_limits=list(zip({limits}))")
    if "episodes" in stated:
        first, _, end = stated["episodes"].partition(":")
        arguments.append(f"episodes={(int(first or 0), int(end) if end else None)!r}")
    if "inflate-limit" in stated:
        arguments.append(f"inflate_limit={int(float(stated['inflate-limit']) * 2**20)!r}")
    load = f"lieid.Recording.load(path, {', '.join(arguments)})"
    options = [" ".join([f"--{n}", *v]) for n, v in inputs.options if f"--{n}" in CORRECTIONS]
    if not options:
        return [f"load = lambda path: {load}"]
    return [
        "from lieid_casadi.premises.correction import correction_of",
        f"correction = correction_of({options!r}, robot.n)",
        "robot = correction.of_robot(robot)",
        f"load = lambda path: correction.of_recording({load})",
    ]


def _step(session: Session) -> ModelStep:
    assert session.step is not None  # there is nothing to reproduce before inputs are open
    return session.step


def _effects(step: ModelStep) -> str:
    """Return the effects as written on the command line, as short as possible."""
    joints = [int(j) for e in step.effects for j in e.partition(":")[2].split("<") if j]
    n = max(joints, default=1)
    return ",".join(labels(parse_effects(step.effects, n), n))


def _paths(inputs: WorkbenchInputs, step: ModelStep, role: Role) -> list[str]:
    """Return the recordings of a role as ``FILE@T0:T1`` without what is excluded."""
    paths = []
    for k, recording in enumerate(inputs.recordings):
        if recording.role != role:
            continue
        file, _, stated = recording.path.rpartition("@") if "@" in recording.path else (
            recording.path, "", ":",
        )  # fmt: skip
        low, _, high = stated.partition(":")
        for start, end in kept_parts(step.excluded, k):
            first = low if start is None else f"{start:.12g}"
            last = high if end is None else f"{end:.12g}"
            paths.append(file if not first and not last else f"{file}@{first}:{last}")
    return paths
