"""Torque of recordings without torque: from motor currents, or from commanded positions."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike

from lieid_casadi.errors import RecordingError
from lieid_casadi.recording.arrays import Array
from lieid_casadi.recording.measurement import Measurement
from lieid_casadi.recording.sample_timing import gap_limit
from lieid_casadi.robot.drive import Drive, commanded_torque

MOST = 0.99  # of the samples that the control laws state


def torque_of_currents(measurement: Measurement, constants: ArrayLike) -> Array:
    """Return the torque (N, n) of the currents, N·m; constants (n,), N·m/A.

    Raises
    ------
    RecordingError
        No currents, or not one finite constant per joint.
    """
    k = np.atleast_1d(np.asarray(constants, dtype=np.float64))
    title, n = measurement.title, measurement.n
    if measurement.current is None:
        raise RecordingError(f"{title}: no motor currents (columns i1…i{n})")
    if k.shape != (n,):
        raise RecordingError(f"{title}: {k.size} torque constants, expected {n}, one per joint")
    if not np.all(np.isfinite(k)) or np.any(k == 0.0):
        joint = int(np.nonzero(~np.isfinite(k) | (k == 0.0))[0][0])
        raise RecordingError(
            f"{title}: torque constant of joint {joint + 1} is {k[joint]:g}, "
            "expected N·m/A other than 0"
        )
    return np.asarray(measurement.current * k)


def torque_of_commands(measurement: Measurement, drives: Sequence[Drive]) -> Array:
    """Return the torque (N, n) that the drives' control laws state, N·m.

    Without measured velocities, those that the damping acts on are differences of the positions.

    Parameters
    ----------
    measurement
        With commanded positions.
    drives
        (n) laws.

    Raises
    ------
    RecordingError
        No commanded positions, or not one law per joint.
    """
    title, n = measurement.title, measurement.n
    if measurement.command is None:
        raise RecordingError(f"{title}: no commanded positions, expected columns qcmd1…qcmd{n}")
    if len(drives) != n:
        raise RecordingError(f"{title}: {len(drives)} drive laws, expected {n}, one per joint")
    velocity = measurement.dq
    if velocity is None:
        velocity = _differences(measurement.t, measurement.q)
    return commanded_torque(drives, measurement.command - measurement.q, velocity)


def is_torque_of_laws(measurement: Measurement, drives: Sequence[Drive]) -> bool:
    """Return whether the torque is that of the control laws; ends that were cut may differ."""
    if measurement.tau is None or measurement.command is None:
        return False
    stated = np.isclose(measurement.tau, torque_of_commands(measurement, drives))
    return bool(np.mean(stated) >= MOST)


def _differences(t: Array, q: Array) -> Array:
    """Return velocities (N, n), none of them across a gap."""
    edges = [0, *(np.flatnonzero(np.diff(t) > gap_limit(t)) + 1).tolist(), len(t)]
    parts = [
        np.gradient(q[a:b], t[a:b], axis=0) if b - a > 1 else np.zeros_like(q[a:b])
        for a, b in pairwise(edges)
    ]
    return np.concatenate(parts)
