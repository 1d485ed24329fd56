"""The commands and the Python lines that reproduce the state of a page."""

from __future__ import annotations

import shlex

from lieid_casadi.effects import parse_effects
from lieid_casadi.effects.placement import labels
from lieid_casadi.workbench.session import ModelStep, Role, Session, WorkbenchInputs, kept_parts


def shell_lines(session: Session, cutoff: float | None = None) -> str:
    """Return ``lieid`` commands that fit the model of the current step and diagnose it.

    Parameters
    ----------
    cutoff : float, optional
        Of the fit's filter, Hz; by default each command chooses it.
    """
    inputs, step = session.inputs, _step(session)
    if inputs.mode == "changed":
        new = [*_paths(inputs, step, "test"), *_paths(inputs, step, "train")]
        return "\n".join(
            shlex.join(["lieid", command, inputs.fit, *new, *_reading(inputs)])
            for command in ("compare", "diagnose")
        )
    train, test = _paths(inputs, step, "train"), _paths(inputs, step, "test")
    options = [*_robot_options(inputs), *_reading(inputs)]
    options += [] if cutoff is None else ["--cutoff", repr(cutoff)]
    source = inputs.fit or inputs.robot
    effects = ["--effects", _effects(step)]
    tested = ["--test", *test] if test else []
    identify = ["lieid", "identify", source, *train, *tested, *effects, *options, "-o", "fit.json"]
    if inputs.fit:  # lieid diagnose FIT looks for changes since the fit
        return shlex.join(identify)
    diagnose = ["lieid", "diagnose", source, "--train", *train, *tested, *effects, *options]
    return f"{shlex.join(identify)}\n{shlex.join(diagnose)}"


def python_lines(session: Session, cutoff: float | None = None) -> str:
    """Return Python that makes the fit and the comparison of the current step.

    Parameters
    ----------
    cutoff : float, optional
        Of the fit's filter, Hz; by default it is chosen from the data.
    """
    inputs, step = session.inputs, _step(session)
    changed = inputs.mode == "changed"
    lines = ["import lieid_casadi as lieid", *_effects_file_lines(inputs), ""]
    if changed:
        lines += [f"fit = lieid.Fit.load({inputs.fit!r})", "robot = fit.model.robot"]
    elif inputs.fit:
        lines += [f"robot = lieid.Fit.load({inputs.fit!r}).model.robot"]
    else:
        tip = f", tip={inputs.tip!r}" if inputs.tip else ""
        lock = f", lock={list(inputs.lock)!r}" if inputs.lock else ""
        lines += [f"robot = lieid.Robot.load({inputs.robot!r}{tip}{lock})"]
    lines += _drive_lines(inputs)
    given = "".join(f", {name}={value}" for name, value in _load_arguments(inputs))
    lines += [f"load = lambda path: lieid.Recording.load(path{given})"]

    def loaded(role: Role) -> str:
        return "[" + ", ".join(f"load({path!r})" for path in _paths(inputs, step, role)) + "]"

    if changed:
        return "\n".join(
            [
                *lines,
                f"new = {loaded('test')}",
                "comparison = lieid.compare(fit, new)",
                "diagnosis = lieid.diagnose(fit, new)",
            ]
        )
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


def _effects_file_lines(inputs: WorkbenchInputs) -> list[str]:
    """Return lines that register the effects of the user's own file."""
    path = dict(inputs.options).get("effects-file")
    return [] if path is None else ["import runpy", f"runpy.run_path({path!r})"]


def _drive_lines(inputs: WorkbenchInputs) -> list[str]:
    """Return lines that state the control laws of position-controlled drives."""
    stated = dict(inputs.options)
    if "servo" in stated:
        laws = [f"lieid.servo_drive({name.strip()!r})" for name in stated["servo"].split(",")]
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


def _load_arguments(inputs: WorkbenchInputs) -> list[tuple[str, str]]:
    """Return the arguments of `Recording.load` as text."""
    stated, found = dict(inputs.options), list[tuple[str, str]]()
    if inputs.torque_constants:
        constants = [float(k) for k in inputs.torque_constants.split(",")]
        found.append(("torque_constants", repr(constants)))
    if inputs.units:
        found.append(("units", repr(inputs.units)))
    found.append(("drives", "robot.drives"))
    found.append(("joint_names", "[joint.name for joint in robot.joints]"))
    if "episodes" in stated:
        first, _, end = stated["episodes"].partition(":")
        found.append(("episodes", repr((int(first or 0), int(end) if end else None))))
    if "calibration" in stated:
        found.append(("calibration", repr(stated["calibration"])))
        limits = 'list(zip(robot.limit("position_lower"), robot.limit("position_upper")))'
        found.append(("position_limits", limits))
    if "columns" in stated:
        found.append(("columns", repr(stated["columns"])))
    if "inflate-limit" in stated:
        found.append(("inflate_limit", repr(int(float(stated["inflate-limit"]) * 2**20))))
    return found


def _step(session: Session) -> ModelStep:
    assert session.step is not None  # there is nothing to reproduce before inputs are open
    return session.step


def _effects(step: ModelStep) -> str:
    """Return the effects as written on the command line, as short as possible."""
    joints = [int(part) for e in step.effects for part in _joint_numbers(e)]
    n = max(joints, default=1)
    return ",".join(labels(parse_effects(step.effects, n), n))


def _joint_numbers(label: str) -> list[str]:
    where = label.partition(":")[2]
    return [part for part in where.split("<") if part]


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


def _robot_options(inputs: WorkbenchInputs) -> list[str]:
    tip = ["--tip", inputs.tip] if inputs.tip else []
    return [*tip, *(["--lock", *inputs.lock] if inputs.lock else [])]


def _reading(inputs: WorkbenchInputs) -> list[str]:
    words = ["--torque-constants", inputs.torque_constants] if inputs.torque_constants else []
    words += ["--units", inputs.units] if inputs.units else []
    for name, text in inputs.options:
        words += [f"--{name}", text]
    return words
