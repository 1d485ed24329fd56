"""History of one arm: series of all its quantities and what each night's diagnosis found."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from datetime import date

import numpy as np
from numpy.typing import NDArray

from lieid_casadi.fleet.statistics.scatter import NightSeries

ERROR = "error"  # name of the series of a joint's error


@dataclass(frozen=True)
class Quantity:
    """A coefficient of an effect, such as ``coulomb.f_c``, or ``error``, of a joint from 1."""

    name: str
    joint: int

    @property
    def effect(self) -> str:
        """Name of the effect."""
        return self.name.partition(".")[0]

    @property
    def label(self) -> str:
        """Name with the joint: ``coulomb.f_c:2``."""
        return f"{self.name}:{self.joint}"


@dataclass(frozen=True)
class FoundEffect:
    """An effect that the diagnosis of a night found; joint from 1, None for the whole arm."""

    change: float
    std: float | None
    unit: str
    severity: float
    sentence: str


@dataclass(frozen=True, eq=False)
class ArmHistory:
    """All nights of one arm since its baseline was started.

    Attributes
    ----------
    serial, robot : str
    joints : int
    dates : tuple of date
        One per night, increasing.
    series : mapping
        Quantity → values of all nights; errors are logarithms relative to the expected error.
    units : mapping
        Quantity → unit.
    found : tuple of mapping
        For each night: (effect, joint) → what the diagnosis found.
    shares : (N,)
        Largest part, over the joints, of the torque that the fit no longer predicts.
    starts : mapping
        Joint → first night of its baseline after an acknowledgement (None: of all joints).
    limits : mapping
        Effect or parameter → largest permitted values.
    """

    serial: str
    robot: str
    joints: int
    dates: tuple[date, ...]
    series: Mapping[Quantity, NightSeries]
    units: Mapping[Quantity, str]
    found: tuple[Mapping[tuple[str, int | None], FoundEffect], ...]
    shares: NDArray[np.float64]
    starts: Mapping[int | None, date]
    limits: Mapping[str, list[float]]

    def until(self, last: date) -> ArmHistory:
        """Return the nights up to a date."""
        count = sum(night <= last for night in self.dates)
        return replace(
            self,
            dates=self.dates[:count],
            series={quantity: s.part(0, count) for quantity, s in self.series.items()},
            found=self.found[:count],
            shares=self.shares[:count],
        )

    def baseline_of(self, joint: int | None) -> int:
        """Return the position of the first night of the baseline of a joint, or of the arm."""
        starts = [self.starts[j] for j in (None, joint) if j in self.starts]
        return sum(night < max(starts) for night in self.dates) if starts else 0
