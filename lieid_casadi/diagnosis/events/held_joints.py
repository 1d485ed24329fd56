"""Joints under position control that rest against a torque which friction cannot hold."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from lieid_casadi.errors import HeldJointWarning
from lieid_casadi.identification import Fit
from lieid_casadi.identification.prediction import relative_temperature, torque_along
from lieid_casadi.recording import Recording, process

EXCESS = 3.0  # times dry friction and the error in motion, above which something holds a joint
LEAST_TIME = 0.5  # s in all, a shorter rest is a reversal


def held_joints(fit: Fit, recordings: Sequence[Recording]) -> list[HeldJointWarning]:
    """Return a warning for each joint that something outside the arm holds: an object, a stop.

    Parameters
    ----------
    fit : Fit
    recordings : sequence of Recording
    """
    robot = fit.model.robot
    if robot.drives is None or any(r.command is None or r.tau is None for r in recordings):
        return []
    dry = np.zeros(robot.n)
    for column, value in zip(fit.model.columns, fit.effect_coefficients, strict=True):
        if column.name == "coulomb.f_c":
            dry[column.joint] = max(value, 0.0)
    limit = EXCESS * (dry + fit.rms_cv)
    time, peak = np.zeros(robot.n), np.zeros(robot.n)
    for raw in process(list(recordings), fit.processing):
        segment = relative_temperature(raw, fit.temperature_mean)
        torque = torque_along(fit.compiled, segment, fit.parameters, fit.shapes)
        assert segment.tau is not None  # that of the recording
        excess = np.where(segment.moving, 0.0, np.abs(segment.tau - torque))
        time += (excess > limit).sum(axis=0) / segment.rate
        peak = np.maximum(peak, excess.max(axis=0))
    return [
        HeldJointWarning(
            f"joint {j + 1} rests for {time[j]:.2g} s although its drive's law states up to "
            f"{peak[j]:.2g} N·m more than gravity needs (dry friction: {dry[j]:.2g} N·m): an "
            "object or a stop holds it, or the drive delivers less than its law states. Commands "
            "and positions do not distinguish these, and do not determine the torque of a contact; "
            "record this joint in free motion"
        )
        for j in np.flatnonzero(time > LEAST_TIME)
    ]
