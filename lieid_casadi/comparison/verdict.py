"""Summary of a comparison in a few sentences."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from lieid_casadi.comparison.comparison import Comparison
from lieid_casadi.comparison.table import digits, percent
from lieid_casadi.errors import FrictionAtRestWarning, SameRecordingWarning
from lieid_casadi.recording.joint_names import joints_text

AT_NOISE = 1.05  # times the noise floor, below which the multiple is not stated
AS_NOISE = 1.3  # times the noise floor, up to which an error is explained by noise
BEYOND_NOISE = 2.0  # times the noise floor, from which an error is certainly systematic


def verdict(
    comparison: Comparison, *, remedy: str = "lieid diagnose searches for missing effects"
) -> str:
    """Return how large the error is, and whether it exceeds the noise of the measurement.

    Parameters
    ----------
    comparison : Comparison
    remedy : str
        What to do about a systematic error.
    """
    c = comparison
    names = ", ".join(source.name or "the recording" for source in c.recordings)
    trained = any(isinstance(warning, SameRecordingWarning) for warning in c.warnings)
    training = ", used to fit the model" if trained else ""
    sentences = [f"{names} ({c.duration:.3g} s{training}): {_size(c)}."]
    if np.any(np.isfinite(_over_noise(c))):
        sentences.append(_noise(c, remedy))
    if any(isinstance(warning, FrictionAtRestWarning) for warning in c.warnings):
        at_rest = ", ".join(digits(rms) for rms in c.rms_at_rest[c.rest_dominates])
        sentences.append(
            f"On {joints_text(c.rest_dominates)} the error at rest, where friction is "
            f"undetermined, is larger (RMS {at_rest})."
        )
    return " ".join(sentences)


def _size(c: Comparison) -> str:
    moves = bool(np.isfinite(c.relative_rms_moving).any())
    relative, rms = (c.relative_rms_moving, c.rms_moving) if moves else (c.relative_rms, c.rms)
    relative = relative[np.isfinite(relative)]
    if not relative.size:
        return "the measured torque is zero"
    error = "the error in motion" if moves else "no joint moves; the error at rest"
    worst = c.worst_joint
    where = f"joint {worst + 1} (RMS {digits(rms[worst])} {c.units[worst]})"
    if relative.size == 1 or relative.max() - relative.min() < 5e-4:
        return f"{error} is {percent(relative.max())} of the torque"
    return (
        f"{error} is {percent(relative.min())} to {percent(relative.max())} of the torque, "
        f"largest on {where}"
    )


def _over_noise(c: Comparison) -> NDArray[np.float64]:
    """Return the error in motion in multiples of the noise floor (n,).

    NaN for joints that do not move, without measured torque, or without a noise floor.
    """
    return np.where((c.noise_floor > 0.0) & (c.torque_rms > 0.0), c.over_noise, np.nan)


def _noise(c: Comparison, remedy: str) -> str:
    """Compare the error in motion with the noise floor."""
    ratio = np.nan_to_num(_over_noise(c), nan=0.0)
    floor = "the noise floor"
    if ratio.max() < AT_NOISE:
        return f"The error in motion is within 5 % of {floor}: no systematic error is detectable."
    if ratio.max() <= AS_NOISE:
        return (
            f"The error in motion is at most {ratio.max():.2g} times {floor}: "
            "no systematic error is detectable."
        )
    beyond = ratio > BEYOND_NOISE
    if not beyond.any():
        return f"The error in motion is at most {ratio.max():.2g} times {floor}."
    most = int(np.argmax(ratio))
    if beyond.sum() == 1:
        size_text = f"On joint {most + 1} the error in motion is {ratio[most]:.2g} times {floor}"
    else:
        where = "every joint" if beyond.all() else joints_text(beyond)
        size_text = (
            f"On {where} the error in motion is more than {BEYOND_NOISE:g} times {floor}, "
            f"most on joint {most + 1} ({ratio[most]:.2g} times)"
        )
    return f"{size_text}: part of it is systematic; {remedy}."
