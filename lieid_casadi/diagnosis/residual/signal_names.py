"""Names of signals in formulas and figures: ``q3``, ``dq1``, ``load2``, ``temp4``, ``t``."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from lieid_casadi.diagnosis.screening.effect_columns import SegmentSignals

#: Kind of a signal → key of `SegmentSignals.values`.
SIGNAL_KEYS = {
    "q": "q",
    "dq": "dq",
    "ddq": "ddq",
    "load": "load",
    "temp": "temperature",
    "t": "time",
}
UNITS = {"q": "rad", "dq": "rad/s", "ddq": "rad/s²", "load": "N·m", "temp": "°C", "t": "s"}


def split_name(name: str) -> tuple[str, int]:
    """Return a signal's kind and joint (from 0): ``dq3`` → ``dq``, 2; ``t`` → ``t``, 0."""
    kind = name.rstrip("0123456789")
    return kind, int(name[len(kind) :] or 1) - 1


def signal_values(signals: SegmentSignals, name: str) -> NDArray[np.float64]:
    """Return the values of a signal (K,) along a segment."""
    kind, joint = split_name(name)
    return np.asarray(signals.values[SIGNAL_KEYS[kind]][:, joint])


def signal_unit(name: str, revolute: Sequence[bool]) -> str:
    """Return the unit of a signal; ``revolute`` marks the joints that are not prismatic."""
    kind, joint = split_name(name)
    unit = UNITS[kind]
    return unit if revolute[joint] else unit.replace("N·m", "N").replace("rad", "m")
