"""Base parameters: the combinations of parameters that torques depend on.

A change of parameters that leaves every torque unchanged (`lieid_casadi.dynamics.null_space`)
expresses one column of the regressor by the others. Columns are scanned from the first to the last
and kept if they are independent of those kept.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lieid_casadi.arrays import Indices
from lieid_casadi.dynamics.null_space import RANK_TOLERANCE, EnergyColumn, null_space, rounded
from lieid_casadi.robot import Robot
from lieid_casadi.robot.inertia import LINK_PARAMETER_NAMES

Matrix = NDArray[Any]
SHOWN = 1e-9


@dataclass(frozen=True, eq=False)
class BaseParameters:
    """The minimal parameters β = combination · π of a regressor's columns."""

    names: tuple[str, ...]  # of all P columns
    kept: Indices  # (p,): columns that span the others: the first independent ones
    #: (p, P): coefficient 1 on the kept column, the rest on dropped ones. Floats, or floats and
    #: polynomials of lengths (`lieid_casadi.dynamics.symbolic_lengths`)
    combination: Matrix

    @property
    def count(self) -> int:
        """Number of base parameters p."""
        return len(self.kept)

    @cached_property
    def dropped(self) -> Indices:
        """Columns that are combinations of kept ones, or invisible."""
        return np.setdiff1d(np.arange(len(self.names)), self.kept)

    @cached_property
    def invisible(self) -> Indices:
        """Dropped columns that act on no torque at all."""
        visible = np.abs(self.combination[:, self.dropped]).max(axis=0, initial=0.0) > 0.0
        return np.asarray(self.dropped[~visible])

    def expression(self, k: int, *, digits: int = 6) -> str:
        """Return base parameter k as a sum of link parameters, equal factors grouped.

        E.g. ``mcx3 + 0.0825 (m4 + m5 + m6 + m7)``. Factors below 1e-9, from
        rounding in the robot's file, are not shown.
        """
        row = self.combination[k]
        first = int(self.kept[k])
        groups: dict[str, list[str]] = {}
        for index in np.flatnonzero(np.abs(row) > SHOWN):
            if index != first:
                sign, size = _factor(row[index], digits)
                groups.setdefault(f"{sign} {size}", []).append(self.names[index])
        terms = [self.names[first]]
        for factor, members in groups.items():
            sign, size = factor.split(maxsplit=1)
            if size == "1":
                terms += [f"{sign} {name}" for name in members]
            elif len(members) == 1:
                terms.append(f"{factor} {members[0]}")
            else:
                terms.append(f"{factor} ({' + '.join(members)})")
        return " ".join(terms)

    def lift(self, base: Matrix, prior: Matrix | None = None) -> Matrix:
        """Return parameters (P,) of base values (p,), the nearest to a prior (P,) or to zero."""
        start = np.zeros(len(self.names)) if prior is None else np.asarray(prior, dtype=float)
        miss = np.asarray(base) - self.combination @ start
        solution, *_ = np.linalg.lstsq(self.combination, miss, rcond=None)
        return np.asarray(start + solution)


def _factor(value: Any, digits: int) -> tuple[str, str]:
    """Return sign and size of a coefficient as text."""
    if isinstance(value, float):
        return "-" if value < 0 else "+", f"{abs(value):.{digits}g}"
    sign, size = value.text(digits=digits)
    return sign, size


def link_parameter_names(n: int) -> tuple[str, ...]:
    """Return the names of 10 n link parameters, joints from 1: ``m1 … Izz1, m2 …``."""
    return tuple(f"{name}{i}" for i in range(1, n + 1) for name in LINK_PARAMETER_NAMES)


def base_parameters(
    robot: Robot,
    extra: Sequence[EnergyColumn | None] = (),
    extra_names: Sequence[str] = (),
) -> BaseParameters:
    """Return the base parameters of [Y, further columns with names].

    ``extra`` has one entry per column after the 10 n link columns: its `EnergyColumn`, or None for
    a column that link parameters cannot reproduce.
    """
    return reduce(null_space(robot, extra), (*link_parameter_names(robot.n), *extra_names))


def reduce(null: Matrix, names: tuple[str, ...]) -> BaseParameters:
    """Return the base parameters given a basis (d, P) of the invisible parameter changes."""
    columns = len(names)
    dropped = _last_touched(null)
    kept = np.setdiff1d(np.arange(columns), dropped)
    rows = np.linalg.solve(null[:, dropped], null[:, kept])
    combination = np.zeros((len(kept), columns))
    combination[np.arange(len(kept)), kept] = 1.0
    # null row: y_dropped + Σ row_k y_k = 0, so π_dropped adds −row_k to the kept k
    combination[:, dropped] = -rows.T
    return BaseParameters(names, kept, rounded(combination))


def _last_touched(null: Matrix) -> Indices:
    """Return the columns that are combinations of columns before them, last first.

    Elimination from the right: each invisible change is named after the last column it needs.
    """
    rows = null.copy()
    dropped: list[int] = []
    for column in reversed(range(rows.shape[1])):
        done = len(dropped)
        if done == len(rows):
            break
        pivot = done + int(np.argmax(np.abs(rows[done:, column])))
        if abs(rows[pivot, column]) < RANK_TOLERANCE:
            rows[done:, column] = 0.0
            continue
        rows[[done, pivot]] = rows[[pivot, done]]
        rows[done] /= rows[done, column]
        rows[done + 1 :] -= np.outer(rows[done + 1 :, column], rows[done])
        dropped.append(column)
    return np.array(dropped, dtype=np.intp)
