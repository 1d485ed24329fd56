"""Small curves of the fitted torque of each effect over the signal that it depends on."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from lieid_casadi.comparison.effect_torques import effect_torques
from lieid_casadi.effects import Effect
from lieid_casadi.identification import Fit
from lieid_casadi.recording import Processed, Recording, process
from lieid_casadi.workbench.computing.results import EffectCurve

Array = NDArray[np.float64]
LONGEST = 40.0  # s of the recording that the curves are made of
POINTS = 160
#: Signals in the order in which one is chosen for the axis: name, unit (turning, sliding joint).
AXES = (
    ("temperature", "°C", "°C"),
    ("load", "N·m", "N"),
    ("time", "s", "s"),
    ("ddq", "rad/s²", "m/s²"),
    ("dq", "rad/s", "m/s"),
    ("q", "rad", "m"),
)


def effect_curves(fit: Fit, recording: Recording) -> dict[str, EffectCurve]:
    """Return the curve of every effect that acts on one joint, by its label."""
    start = float(recording.t[0])
    part = recording if recording.duration <= LONGEST else recording.cut(start, start + LONGEST)
    segment = process([part], fit.processing)[0]
    load = fit.compiled.inverse_dynamics(segment.q, segment.dq, segment.ddq, fit.link_parameters)
    curves = {}
    for each in effect_torques(fit, segment):
        joint, effect = each.placement.joint, each.placement.effect
        if each.placement.whole_arm:
            continue
        name = _axis(effect)
        source = joint if each.placement.source is None else each.placement.source
        signal = _signal(name, segment, load)
        if signal is None:
            continue
        x = signal if signal.ndim == 1 else signal[:, source]
        rows = np.linspace(0, len(x) - 1, POINTS).astype(int)
        unit = next(
            u if fit.model.robot.joints[joint].revolute else s for n, u, s in AXES if n == name
        )
        curves[each.placement.label] = EffectCurve(
            name, unit, tuple(x[rows].tolist()), tuple(each.torque[rows, joint].tolist())
        )
    return curves


def _axis(effect: Effect) -> str:
    """Return the signal over which an effect is shown."""
    if "q" in effect.signals and "sign" not in effect.signals:
        return "q"
    used = {*effect.signals, *(["dq"] if "sign" in effect.signals else [])}
    return next((name for name, _, _ in AXES if name in used), "dq")


def _signal(name: str, segment: Processed, load: Array) -> Array | None:
    if name == "load":
        return load
    if name == "time":
        return segment.t
    return getattr(segment, name)  # type: ignore[no-any-return]
