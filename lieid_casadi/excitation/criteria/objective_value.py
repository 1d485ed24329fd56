"""Value and derivatives of an objective at one point of the search."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class ObjectiveValue:
    """An objective at z: value, gradient (m,), G (p, p) and further limits excess ≤ 0.

    ``excess`` (s,) has the slopes (s, m); most objectives have none.
    """

    value: float
    gradient: Array
    gram: Array
    excess: Array
    slopes: Array
