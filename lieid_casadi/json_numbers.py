"""Numbers for JSON, which has neither NaN nor infinity."""

from __future__ import annotations

import math
from collections.abc import Iterable


def number_or_none(value: float) -> float | None:
    """Return a finite number as a float, None for NaN and infinity."""
    return float(value) if math.isfinite(value) else None


def numbers_or_none(values: Iterable[float]) -> list[float | None]:
    """Return a list of finite numbers, None in place of NaN and infinity."""
    return [number_or_none(value) for value in values]
