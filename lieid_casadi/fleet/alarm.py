"""One alarm of an arm, as it is stored in the history."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import date
from typing import Any


@dataclass(frozen=True)
class Alarm:
    """An alarm as in the history.

    Attributes
    ----------
    serial : str
    joint : int or None
        From 1; None for the whole arm.
    quantity : str
        Name of an effect, ``error`` or ``unexplained``.
    since, last : date
        First and last night of the change.
    change, std : float or None
    unit, sentence : str
    raised : date
        Night on which it became significant.
    closed : date or None
    note : str
        Of the acknowledgement.
    severity : float
        Part of a joint's torque that the fit no longer predicts.
    slope : float or None
        Of a drift, per day.
    limit_date : date or None
        When a drift reaches the limit of the fleet file.
    series : str
        Labels of the quantities that the alarm is about, separated by commas.
    slope_low, slope_high : float or None
        Bounds of the slope of 95 % confidence.
    """

    serial: str
    joint: int | None
    quantity: str
    since: date
    last: date
    change: float | None
    std: float | None
    unit: str
    sentence: str
    raised: date
    closed: date | None = None
    note: str = ""
    severity: float = 0.0
    slope: float | None = None
    limit_date: date | None = None
    series: str = ""
    slope_low: float | None = None
    slope_high: float | None = None

    def to_dict(self) -> dict[str, Any]:
        """Return the alarm for JSON; dates as ISO 8601."""
        return {
            key: value.isoformat() if isinstance(value, date) else value
            for key, value in vars(self).items()
        }

    @property
    def labels(self) -> frozenset[str]:
        """Labels of the quantities that the alarm is about."""
        return frozenset(self.series.split(",")) - {""}
