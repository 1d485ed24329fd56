"""Arms of one kind compared with each other: an outlier is a finding even without history."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.stats import median_abs_deviation
from scipy.stats import t as student

from lieid_casadi.arrays import Array
from lieid_casadi.fleet.history import History
from lieid_casadi.tables import Table, make_table

FEWEST_ARMS = 6  # of one kind that are compared
MOST_OUTLIERS = 0.25  # part of the arms of a kind
FALSE_OUTLIERS = 1e-3  # of the arms of one kind together, if their coefficients are normal


@dataclass(frozen=True)
class Outlier:
    """A coefficient of an arm that is unlike those of the other arms with the same robot."""

    serial: str
    robot: str
    name: str
    joint: int  # from 1
    value: float  # on the latest night
    median: float  # over the arms
    spread: float  # robust standard deviation over the arms
    unit: str
    arms: int

    @property
    def sentence(self) -> str:
        """The finding in words."""
        usual = f"{self.median:.4g} ± {self.spread:.2g} {self.unit}"
        return (
            f"{self.serial}: {self.name} of joint {self.joint} is {self.value:.4g} {self.unit}; "
            f"that of the {self.arms} arms {self.robot!r} is {usual}"
        )


def outliers(history: History) -> list[Outlier]:
    """Return the outliers among arms with the same robot, on the latest night of each."""
    kinds = defaultdict[str, dict[tuple[str, int, str], list[tuple[str, float]]]](
        lambda: defaultdict(list)
    )
    for robot, name, joint, unit, serial, value in history.rows(
        "SELECT a.robot, p.name, p.joint, p.unit, serial, p.value FROM latest l "
        "JOIN arms a USING (serial) JOIN parameters p USING (run_id, serial) "
        "WHERE isfinite(p.value) ORDER BY ALL"
    ):
        kinds[robot][name, joint, unit].append((serial, value))
    found = []
    for robot, coefficients in kinds.items():
        for (name, joint, unit), rows in coefficients.items():
            values = np.array([value for _, value in rows])
            for k in extreme(values, FALSE_OUTLIERS / len(coefficients)):
                middle = float(np.median(values))
                spread = float(median_abs_deviation(values, scale="normal"))
                serial, value = rows[k]
                found.append(
                    Outlier(serial, robot, name, joint, value, middle, spread, unit, len(rows))
                )
    return sorted(found, key=lambda x: (x.serial, x.joint, x.name))


def extreme(values: Array, level: float) -> list[int]:
    """Return the positions of outliers among normal values (N,), at a false rate of ``level``.

    The generalized extreme Studentized deviate test (Rosner, Technometrics 25, 1983): the most
    extreme value is removed again and again, so that outliers do not hide each other.
    """
    count = len(values)
    if count < FEWEST_ARMS:
        return []
    rest, removed, outliers = np.arange(count), list[int](), 0
    for step in range(1, int(MOST_OUTLIERS * count) + 1):
        own = values[rest]
        spread = float(own.std(ddof=1))
        if not spread > 0.0:
            break
        worst = int(np.argmax(np.abs(own - own.mean())))
        deviation = abs(float(own[worst] - own.mean())) / spread
        n = len(rest)
        quantile = float(student.isf(level / (2.0 * n), n - 2))
        critical = (n - 1) * quantile / np.sqrt((n - 2 + quantile**2) * n)
        removed.append(int(rest[worst]))
        rest = np.delete(rest, worst)
        if deviation > critical:
            outliers = step
    return removed[:outliers]


def outlier_table(found: Sequence[Outlier]) -> Table:
    """Return one row per outlier."""
    return make_table(
        "Arms unlike the others of their kind",
        ("serial", "robot", "coefficient", "joint", "value", "median", "spread", "unit", "arms"),
        [
            (x.serial, x.robot, x.name, x.joint, x.value, x.median, x.spread, x.unit, x.arms)
            for x in found
        ],
        note="On the latest night of each arm. Spread: robust standard deviation over the arms.",
    )
