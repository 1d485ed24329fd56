"""Conversion of what files state to SI units, and of currents and commands to torque."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise
from typing import TypeVar

import numpy as np
from numpy.typing import ArrayLike
from scipy.interpolate import CubicSpline

from lieid_casadi.arrays import Array, Mask
from lieid_casadi.errors import RecordingError
from lieid_casadi.recording.measurement import Measurement
from lieid_casadi.recording.sample_timing import TIME_UNITS, segment_edges
from lieid_casadi.robot.drive import Drive, commanded_torque

Measured = TypeVar("Measured", bound=Measurement)
#: Unit of angles -> radians.
ANGLE_UNITS = {"rad": 1.0, "deg": np.pi / 180.0}


def unit_factors(units: str | Sequence[str]) -> tuple[float, float]:
    """Return the factors of time and of angles to seconds and radians."""
    names = unit_names(units)
    for name in names:
        if name not in TIME_UNITS and name not in ANGLE_UNITS:
            known = ", ".join([*ANGLE_UNITS, *TIME_UNITS])
            raise RecordingError(f"units: found {name!r}, expected some of {known}")
    times = [name for name in names if name in TIME_UNITS]
    angles = [name for name in names if name in ANGLE_UNITS]
    for found in (times, angles):
        if len(found) > 1:
            raise RecordingError(f"units: found both {found[0]} and {found[1]}, expected one")
    return TIME_UNITS[times[0]] if times else 1.0, ANGLE_UNITS[angles[0]] if angles else 1.0


def unit_names(units: str | Sequence[str]) -> tuple[str, ...]:
    """Return the names of units, given separated by commas or as a sequence."""
    names = units.split(",") if isinstance(units, str) else units
    return tuple(name.strip() for name in names if name.strip())


def convert_units(
    measurement: Measured, units: str | Sequence[str], revolute: Mask | None = None
) -> Measured:
    """Return a measurement in SI units; angles of joints that turn alone (``revolute`` (n,))."""
    time, angle = unit_factors(units)
    if time == 1.0 and angle == 1.0:
        return measurement
    factor = np.full(measurement.n, angle)
    if revolute is not None:
        factor[~np.asarray(revolute, dtype=bool)] = 1.0

    given = {field: getattr(measurement, field) for field in ("q", "dq", "ddq", "command")}
    return replace(
        measurement,
        t=measurement.t * time,
        units=tuple(name for name in unit_names(units) if name not in ("rad", "s")),
        **{field: values * factor for field, values in given.items() if values is not None},
    )


MOST = 0.5  # of the samples that the control laws state; at cut ends, velocities are others


def torque_of_currents(measurement: Measurement, constants: ArrayLike) -> Array:
    """Return the torque (N, n) of the currents, N·m; constants (n,), N·m/A."""
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
    """Return the torque (N, n) that the drives' control laws state, N·m."""
    title, n = measurement.title, measurement.n
    if measurement.command is None:
        raise RecordingError(f"{title}: no commanded positions, expected columns qcmd1…qcmd{n}")
    if len(drives) != n:
        raise RecordingError(f"{title}: {len(drives)} drive laws, expected {n}, one per joint")
    velocity = measurement.dq
    if velocity is None:
        velocity = _differences(measurement.t, measurement.q)
    error = measurement.command - measurement.q
    return commanded_torque(drives, measurement.t, error, velocity)


def is_torque_of_laws(measurement: Measurement, drives: Sequence[Drive]) -> bool:
    """Return whether the torque is that of the control laws; ends that were cut may differ."""
    if measurement.tau is None or measurement.command is None:
        return False
    stated = np.isclose(measurement.tau, torque_of_commands(measurement, drives))
    return bool(np.mean(stated) >= MOST)


def _differences(t: Array, q: Array) -> Array:
    """Return velocities (N, n), none of them across a gap, by cubic splines."""
    parts = [
        CubicSpline(t[a:b], q[a:b], axis=0)(t[a:b], 1) if b - a > 1 else np.zeros_like(q[a:b])
        for a, b in pairwise(segment_edges(t))
    ]
    return np.concatenate(parts)
