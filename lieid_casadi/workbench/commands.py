"""The commands that reproduce the state of a page."""

from __future__ import annotations

import shlex

from lieid_casadi.effects import parse_effects
from lieid_casadi.effects.placement import labels
from lieid_casadi.workbench.session import ModelStep, Role, Session, WorkbenchInputs, kept_parts


def shell_lines(session: Session, cutoff: float | None = None) -> str:
    """Return ``lieid`` commands that fit the model of the current step and diagnose it."""
    inputs, step = session.inputs, session.step
    assert step is not None  # there is nothing to reproduce before inputs are open
    train, test = _paths(inputs, step, "train"), _paths(inputs, step, "test")
    options = [*inputs.words, *([] if cutoff is None else ["--cutoff", repr(cutoff)])]
    source = inputs.fit or inputs.robot
    given = [*(["--test", *test] if test else []), "--effects", _effects(step), *options]
    identify = shlex.join(["lieid", "identify", source, *train, *given, "-o", "fit.json"])
    if inputs.fit:  # lieid diagnose FIT looks for changes since the fit
        return identify
    return f"{identify}\n{shlex.join(['lieid', 'diagnose', source, '--train', *train, *given])}"


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
