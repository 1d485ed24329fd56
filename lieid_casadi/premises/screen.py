"""Errors of the plain fit under a hypothesis, and the comparison of hypotheses."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np

from lieid_casadi.arrays import Array
from lieid_casadi.premises.correction import Correction
from lieid_casadi.premises.plain_fit import (
    FRICTION,
    OWN,
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
#: Least part of a joint's power that is friction, and of its standard deviation (jackknife), from
#: which the sign of friction is clear.
LEAST_POWER, CLEAR = 0.05, 5.0
#: Hypotheses whose rigid columns are computed at once: a call costs as much as some 300 instants.
AT_ONCE = 12


@dataclass(frozen=True, eq=False)
class Alternative:
    """A hypothesis on robot and recording other than the given one.

    ``joints`` (from 0, at most three) are those that it concerns, ``value`` its value for JSON,
    ``what`` a clause that states it, ``remedy`` the option or edit that corrects it. ``cost`` is
    the decrease of the score that its free values are worth. ``small`` marks a value within the
    range of an effect of the library, ``discrete`` an alternative without free values.
    """

    premise: str
    joints: tuple[int, ...]
    value: Mapping[str, Any]
    what: str
    remedy: str
    correction: Correction
    cost: float = 0.0
    small: bool = False
    discrete: bool = False


@dataclass(frozen=True, eq=False)
class Errors:
    """RMS errors (n,) of the plain fits, N·m, and the torque's own RMS about its mean.

    ``friction`` (P, n) is the mean power that friction takes from each joint in the fits without
    one part each, relative to the mean magnitude of the joint's power.
    """

    free: FreeFit
    stated: StatedFit | None
    scale: Array
    friction: Array

    @property
    def driven(self) -> Array:
        """Joints (n,) that friction clearly drives (-1), which it cannot do, or brakes (1)."""
        mean = self.friction.mean(axis=0)
        spread = np.sqrt(len(self.friction) - 1.0) * self.friction.std(axis=0)
        clear = np.abs(mean) > np.maximum(LEAST_POWER, CLEAR * spread)
        return np.asarray(np.sign(mean) * clear)

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

    def errors(self, correction: Correction, rigid: Rigid | None = None) -> Errors:
        """Return the errors under a correction; the rigid columns may be given."""
        if correction.late:  # torque is shifted before instants are left out
            s = correction.of_samples(self.samples).thinned(self.most)
        else:
            s = self.thin if correction.signals_stay else correction.of_samples(self.thin)
        if rigid is None:
            stay = correction.positions_stay
            rigid = self.rigid if stay else rigid_columns(self.robot, *self._motion(correction))
        gravity = self.gravity if correction.gravity is None else correction.gravity
        columns = rigid.columns(gravity)
        stated = None
        if self.parameters is not None:
            stated = stated_fit(columns, self.parameters, s)
        fitted = free_fit(equations(columns, s, parts=self.parts))
        own = fitted.without[:, 10 * self.n :].reshape(-1, self.n, OWN)[:, :, FRICTION]
        friction = np.einsum("pjk,jk->pj", own, s.own_power)
        return Errors(fitted, stated, s.spread, friction)

    def _motion(self, correction: Correction) -> tuple[Array, Array, Array]:
        """Return corrected positions, velocities and accelerations."""
        s = correction.of_samples(self.thin)
        return s.q, s.dq, s.ddq

    def score(self, correction: Correction) -> float:
        """Return the score of a correction: negative where errors fall."""
        if correction.key not in self._scores:
            self.scores([correction])
        return self._scores[correction.key]

    def scores(self, corrections: Sequence[Correction]) -> list[float]:
        """Return the scores of corrections, whose rigid columns are computed at once."""
        new = list({c.key: c for c in corrections if c.key not in self._scores}.values())
        moving = [c for c in new if not c.positions_stay and not c.late]
        for first in range(0, len(moving), AT_ONCE):
            some = moving[first : first + AT_ONCE]
            motions = zip(*(self._motion(c) for c in some), strict=True)
            columns = rigid_columns(self.robot, *(np.concatenate(x) for x in motions))
            size = len(self.thin.t)
            for k, correction in enumerate(some):
                at = slice(k * size, (k + 1) * size)
                rigid = Rigid(columns.motion[..., at], columns.gravity[..., at])
                self._scores[correction.key] = self.errors(correction, rigid).score(self.base)
        for correction in new:
            if correction.key not in self._scores:
                self._scores[correction.key] = self.errors(correction).score(self.base)
        return [self._scores[c.key] for c in corrections]


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
