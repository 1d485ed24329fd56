"""Errors of the plain fit under a hypothesis, and the comparison of hypotheses."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np

from lieid_casadi.arrays import Array
from lieid_casadi.premises.correction import Correction
from lieid_casadi.premises.plain_fit import (
    FreeFit,
    Samples,
    StatedFit,
    equations,
    free_fit,
    stated_fit,
)
from lieid_casadi.premises.rigid_columns import Rigid, rigid_columns
from lieid_casadi.robot import Robot

#: Least relative error that counts: below it, ratios of errors are rounding.
LEAST_RELATIVE = 1e-4


@dataclass(frozen=True, eq=False)
class Alternative:
    """A hypothesis on robot and recording other than the given one.

    ``joints`` (from 0, at most three) are those that it concerns, ``value`` its value for JSON,
    ``what`` a clause that states it, ``remedy`` the option or edit that corrects it. ``cost`` is
    the decrease of the score that its free values are worth, and ``small`` marks a value within the
    range of an effect of the library.
    """

    premise: str
    joints: tuple[int, ...]
    value: Mapping[str, Any]
    what: str
    remedy: str
    correction: Correction
    cost: float = 0.0
    small: bool = False


@dataclass(frozen=True, eq=False)
class Errors:
    """RMS errors (n,) of the plain fits, N·m, and the torque's own RMS about its mean."""

    free: FreeFit
    stated: StatedFit | None
    scale: Array

    @property
    def relative(self) -> Array:
        """(1 or 2, n) errors, free and stated, as parts of the torque."""
        found = [self.free.held_out] if self.stated is None else [
            self.free.held_out, self.stated.error
        ]  # fmt: skip
        return np.maximum(np.array(found) / self.scale, LEAST_RELATIVE)

    def score(self, base: Errors) -> float:
        """Return the sum of the logarithms of all errors relative to those of a base."""
        return float(np.sum(np.log(self.relative / base.relative)))


@dataclass(frozen=True, eq=False)
class Screen:
    """Robot and samples on which hypotheses are compared."""

    robot: Robot
    samples: Samples
    most: int = 300
    parts: bool = False
    stated_torque: bool = True
    _scores: dict[bytes, float] = field(default_factory=dict)

    @property
    def n(self) -> int:
        """Number of joints."""
        return self.robot.n

    @cached_property
    def parameters(self) -> Array | None:
        """Stated link parameters (10 n,), or None without them."""
        stated = self.robot.has_inertia and self.stated_torque
        return self.robot.link_parameters if stated else None

    @cached_property
    def gravity(self) -> Array:
        """Gravity that the robot states (3,)."""
        return np.asarray(self.robot.gravity, dtype=float)

    @cached_property
    def thin(self) -> Samples:
        """At most ``most`` of the samples."""
        return self.samples.thinned(self.most)

    @cached_property
    def rigid(self) -> Rigid:
        """Rigid columns of the samples as they are."""
        return rigid_columns(self.robot, self.thin.q, self.thin.dq, self.thin.ddq)

    @cached_property
    def base(self) -> Errors:
        """Errors of the hypothesis that nothing is wrong."""
        return self.errors(Correction.none(self.n))

    def errors(self, correction: Correction) -> Errors:
        """Return the errors under a correction."""
        if correction.late:  # torque is shifted before instants are left out
            s = correction.of_samples(self.samples).thinned(self.most)
        else:
            s = correction.of_samples(self.thin)
        kept = correction.torque_alone or (
            correction.gravity is not None
            and np.array_equal(correction.position, np.eye(self.n))
            and not correction.zero.any()
        )
        rigid = self.rigid if kept else rigid_columns(self.robot, s.q, s.dq, s.ddq)
        gravity = self.gravity if correction.gravity is None else correction.gravity
        given = equations(rigid.columns(gravity), s, parts=self.parts)
        stated = None
        if self.parameters is not None:
            stated = stated_fit(rigid, gravity, self.parameters, s)
        spread = [np.std(s.tau[s.used[:, j], j]) for j in range(self.n)]
        return Errors(free_fit(given), stated, np.maximum(spread, 1e-9))

    def score(self, correction: Correction) -> float:
        """Return the score of a correction: negative where errors fall."""
        key = correction.key
        if key not in self._scores:
            self._scores[key] = self.errors(correction).score(self.base)
        return self._scores[key]


def best_on(function: Callable[[float], float], grid: Array, *, rounds: int = 2) -> float:
    """Return the grid's best value, refined by parabolas through its neighbours."""
    values = np.array([function(x) for x in grid])
    k = int(np.argmin(values))
    if not 0 < k < len(grid) - 1:
        return float(grid[k])
    xs, fs = grid[k - 1 : k + 2], values[k - 1 : k + 2]
    best, low = float(xs[1]), float(fs[1])
    for _ in range(rounds):
        a, b, _ = np.polyfit(xs - best, fs, 2)
        if a <= 0.0:
            break
        step = float(np.clip(-0.5 * b / a, xs[0] - best, xs[2] - best))
        width = 0.25 * (xs[2] - xs[0])
        centre = best + step
        xs = np.array([centre - width, centre, centre + width])
        fs = np.array([function(x) for x in xs])
        if fs.min() < low:
            best, low = float(xs[np.argmin(fs)]), float(fs.min())
    return best
