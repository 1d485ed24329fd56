"""A comparison in a sentence or two, for the head of a report."""

from __future__ import annotations

import numpy as np

from lieid_casadi.comparison.comparison import Comparison
from lieid_casadi.comparison.table import digits, percent
from lieid_casadi.errors import FrictionAtRestWarning, SameRecordingWarning
from lieid_casadi.recording.joint_names import joints_text

AS_NOISE = 1.3  # times the noise floor: an error that is nothing but noise
BEYOND_NOISE = 2.0


def verdict(comparison: Comparison) -> str:
    """Say how large the error is, and whether more than noise is left."""
    c = comparison
    names = ", ".join(source.name or "the recording" for source in c.recordings)
    seen = any(isinstance(warning, SameRecordingWarning) for warning in c.warnings)
    trained = ", the motion that it was fitted to," if seen else ""
    sentences = [f"On {names} ({c.duration:.3g} s){trained} {_size(c)}."]
    if np.isfinite(c.noise_floor).any():
        sentences.append(_noise(c))
    if any(isinstance(warning, FrictionAtRestWarning) for warning in c.warnings):
        moving = ", ".join(digits(rms) for rms in c.rms_moving[c.rest_weighs])
        sentences.append(
            f"On {joints_text(c.rest_weighs)} much of the error is at rest, where friction is "
            f"undetermined (RMS moving: {moving})."
        )
    return " ".join(sentences)


def _size(c: Comparison) -> str:
    relative = c.relative_rms[np.isfinite(c.relative_rms)]
    if not relative.size:
        return "no torque was measured"
    worst = c.worst_joint
    where = f"joint {worst + 1} (RMS {digits(c.rms[worst])} {c.units[worst]})"
    if relative.size == 1 or relative.max() - relative.min() < 5e-4:
        return f"the error is {percent(relative.max())} of the torque"
    return (
        f"the error is {percent(relative.min())} to {percent(relative.max())} of the torque, "
        f"most on {where}"
    )


def _noise(c: Comparison) -> str:
    """Compare the error in motion with the noise floor."""
    size = np.where(np.isfinite(c.rms_moving), c.rms_moving, c.rms)
    with np.errstate(divide="ignore", invalid="ignore"):
        ratio = np.nan_to_num(size / c.noise_floor, nan=0.0, posinf=0.0)
    lower = "" if c.noise_source == "period_to_period" else ", itself a lower bound"
    if ratio.max() <= AS_NOISE:
        return "That is the noise of the measurement: nothing systematic is left to explain."
    beyond = ratio > BEYOND_NOISE
    if not beyond.any():
        return f"It is {ratio.max():.2g} times the noise floor at most{lower}."
    most = int(np.argmax(ratio))
    if beyond.sum() == 1:
        return (
            f"On joint {most + 1} it is {ratio[most]:.2g} times the noise floor{lower}: "
            "something systematic is left there."
        )
    where = "every joint" if beyond.all() else joints_text(beyond)
    return (
        f"On {where} it is more than {BEYOND_NOISE:g} times the noise floor{lower} "
        f"(joint {most + 1}: {ratio[most]:.2g} times): something systematic is left there."
    )
