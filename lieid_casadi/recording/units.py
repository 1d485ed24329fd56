"""Units of files that are not in SI, and their conversion."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import TypeVar

import numpy as np

from lieid_casadi.errors import RecordingError
from lieid_casadi.recording.arrays import Array, Mask
from lieid_casadi.recording.measurement import Measurement

Measured = TypeVar("Measured", bound=Measurement)
#: Unit of time -> seconds.
TIME_UNITS = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}
#: Unit of angles -> radians.
ANGLE_UNITS = {"rad": 1.0, "deg": np.pi / 180.0}


def unit_factors(units: str | Sequence[str]) -> tuple[float, float]:
    """Return the factors of time and of angles to seconds and radians.

    Parameters
    ----------
    units
        ``deg``, ``ms``, ``us``, ``ns`` (or ``rad``, ``s``): one name, several separated by
        commas, or a sequence of names.

    Raises
    ------
    RecordingError
        An unknown unit, or two units of the same quantity.
    """
    names = units.split(",") if isinstance(units, str) else list(units)
    names = [name.strip() for name in names if name.strip()]
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
    """Return the names of the units other than rad and s."""
    names = units.split(",") if isinstance(units, str) else list(units)
    return tuple(n for name in names if (n := name.strip()) not in ("", "rad", "s"))


def convert_units(
    measurement: Measured, units: str | Sequence[str], revolute: Mask | None = None
) -> Measured:
    """Return a measurement in SI units.

    Parameters
    ----------
    measurement
        As it was read.
    units
        See :func:`unit_factors`. Units of angles apply to q, qcmd, dq (per second) and ddq (per
        second squared); the time unit applies to t alone.
    revolute
        (n,) True for joints that turn; the others keep their metres. None: all turn.
    """
    time, angle = unit_factors(units)
    if time == 1.0 and angle == 1.0:
        return measurement
    factor = np.full(measurement.n, angle)
    if revolute is not None:
        factor[~np.asarray(revolute, dtype=bool)] = 1.0

    def scaled(values: Array | None) -> Array | None:
        return None if values is None else values * factor

    return replace(
        measurement,
        t=measurement.t * time,
        q=measurement.q * factor,
        dq=scaled(measurement.dq),
        ddq=scaled(measurement.ddq),
        command=scaled(measurement.command),
        units=unit_names(units),
    )
