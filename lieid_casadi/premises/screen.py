"""Errors of the plain fit under a hypothesis, and the comparison of hypotheses.

The regressor of the rigid arm is the recursion of `lieid_casadi.dynamics.recursion` in NumPy,
component first and instant last. Each hypothesis needs a few hundred instants of another arm, which
take a millisecond, where a compiled function would first take seconds of the compiler.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np
from scipy.interpolate import CubicSpline

from lieid_casadi.arrays import Array, Indices
from lieid_casadi.dynamics.base_parameters import base_parameters
from lieid_casadi.premises import plain_fit
from lieid_casadi.premises.correction import Correction
from lieid_casadi.robot import Robot

#: Gravity along no axis, m/s²: base parameters for it serve every direction.
ANY_GRAVITY = np.array([3.0, 5.0, -7.0])


@dataclass(frozen=True, eq=False)
class RigidArm:
    """The kept link parameters of an arm, and the constants of its joints."""

    robot: Robot
    kept: Indices
    combination: Array  # (k, 10 n) gives base parameters for gravity in any direction
    #: (12, 3) of each joint: pose in the frame before, over 1, sin q, 1 − cos q (or 1, q, 0)
    poses: tuple[Array, ...]
    own: tuple[Indices, ...]  # numbers of the columns of each link
    wrenches: tuple[Array, ...]  # (6 k, 12) force and moment of these, see `WRENCHES`

    @classmethod
    def of(cls, robot: Robot) -> RigidArm:
        """Return the arm of a robot, whose gravity is not used."""
        base = base_parameters(replace(robot, gravity=ANY_GRAVITY, source=None))
        kept = base.kept
        before, poses = np.eye(4), []
        for joint in robot.joints:
            twist = np.zeros((4, 4))  # screws have no pitch: they turn (ω·v = 0) or slide (ω = 0)
            twist[:3, :3], twist[:3, 3] = HAT @ joint.axis[:3], joint.axis[3:]
            start = np.linalg.solve(before, joint.home)
            terms = np.stack([start, start @ twist, start @ twist @ twist], axis=-1)
            poses.append(terms[:3].reshape(12, 3))
            before = joint.home
        own = tuple(np.flatnonzero(kept // 10 == i) for i in range(robot.n))
        wrenches = tuple(WRENCHES[:, kept[at] % 10].reshape(-1, 12) for at in own)
        return cls(robot, kept, base.combination, tuple(poses), own, wrenches)

    def columns(self, q: Array, dq: Array, ddq: Array, gravity: Array) -> Array:
        """Return columns (n, k, N) of the regressor; gravity (3,) or (3, N) in the base frame."""
        n, size = self.robot.n, len(q)
        made = np.zeros((n, len(self.kept), size))
        # in link axes: ω, α and acceleration, then v and ω of each screw
        carried = np.zeros((3, 3, size))
        carried[2] -= np.reshape(gravity, (3, -1))  # the base accelerates against gravity
        screws = np.zeros((2, n, 3, size))  # v and ω of each
        gradient = np.zeros((3, 3, size))  # of the acceleration in a link
        for i, joint in enumerate(self.robot.joints):
            x = q[:, i]
            turns = [np.sin(x), 1.0 - np.cos(x)] if joint.revolute else [x, np.zeros(size)]
            pose = (self.poses[i] @ [np.ones(size), *turns]).reshape(3, 4, size)
            rotation, position = pose[:, :3], pose[:, 3]
            carried[2] += np.einsum("ckn,kn->cn", gradient, position)
            hat = (HAT.reshape(9, 3) @ position).reshape(3, 3, size)
            v, z = screws[:, :i]
            every = _times(np.concatenate([carried, v + _times(z, hat), z]), rotation)
            carried, screws[:, :i] = every[:3], every[3:].reshape(2, i, 3, size)
            axis, shift = joint.axis[:3, None], joint.axis[3:, None]
            turn = axis * dq[:, i]
            carried[1] += _cross(carried[0], turn) + axis * ddq[:, i]
            if shift.any():
                slide = _cross(2.0 * carried[0] + turn, shift * dq[:, i])
                carried[2] += slide + shift * ddq[:, i]
            carried[0] += turn
            screws[0, i], screws[1, i] = shift, axis
            omega, alpha, acceleration = carried
            state = np.concatenate([acceleration, alpha, omega[SQUARES[0]] * omega[SQUARES[1]]])
            gradient = (GRADIENT @ state).reshape(3, 3, size)
            wrenches = (self.wrenches[i] @ state).reshape(6, -1, size)
            twists = screws[:, : i + 1].transpose(1, 0, 2, 3).reshape(i + 1, 6, size)
            made[: i + 1, self.own[i]] = _times(twists, wrenches)
        return made


def _times(x: Array, matrix: Array) -> Array:
    """Return the rows x (a, k, N) times matrices (k, c, N), instant by instant."""
    return np.asarray(np.einsum("akn,kcn->acn", x, matrix))


def _cross(a: Array, b: Array) -> Array:
    """Return a × b of vectors (3, N), faster than NumPy's for a few hundred."""
    x, y, z = a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]
    return np.array([x, y, z])


def _wrenches(a: Array, alpha: Array, square: Array) -> Array:
    """Return force and moment (6, 10) of the link parameters; ``square`` as in `SQUARES`."""
    x, y, z = alpha
    xx, yy, zz, xy, xz, yz = square
    gradient = [[-yy - zz, xy - z, xz + y], [xy + z, -xx - zz, yz - x], [xz - y, yz + x, -xx - yy]]
    moments = [  # I·α + ω × I·ω
        [x, y - xz, -yz, z + xy, yy - zz, yz],
        [xz, x + yz, y, zz - xx, z - xy, -xz],
        [-xy, xx - yy, xy, x - yz, y + xz, z],
    ]
    made = np.zeros((6, 10))
    made[:3, 0], made[:3, 1:4] = a, gradient
    made[3:, 1:4], made[3:, 4:] = (HAT @ a).T, moments
    return made


#: w ↦ ŵ, as (3, 3, 3).
HAT = np.cross(np.eye(3)[:, None], np.eye(3)[None]).transpose(2, 1, 0)
#: Factors of xx, yy, zz, xy, xz, yz.
SQUARES = np.array([[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]])
#: Force and moment of the link parameters (6, 10, 12), linear in what `_wrenches` takes.
WRENCHES = np.stack([_wrenches(*np.split(e, [3, 6])) for e in np.eye(12)], axis=-1)
GRADIENT = WRENCHES[:3, 1:4].reshape(9, 12)


#: Least relative error that counts: below it, ratios of errors are rounding.
LEAST_RELATIVE = 1e-4
#: Least part of a joint's power that is friction, and of its standard deviation (jackknife), from
#: which the sign of friction is clear.
LEAST_POWER, CLEAR = 0.05, 5.0
#: Error of stated centres of mass, m: a torque error that it gives on one joint is no finding.
COM_ERROR = 0.01
#: Hypotheses whose columns are computed at once.
TOGETHER = 8


@dataclass(frozen=True, eq=False)
class Alternative:
    """A hypothesis on robot and recording other than the given one."""

    premise: str
    joints: tuple[int, ...]  # from 0, at most three, that it concerns
    value: Mapping[str, Any]  # for JSON
    what: str  # a clause that states it; {} is its remedy
    correction: Correction
    cost: float = 0.0  # decrease of the score that its free values are worth
    small: bool = False  # whether its value is within the range of an effect of the library
    remedy: str = ""  # the edit that corrects it, where that is not the options of the correction
    again: str = ""  # the clause if it was found in several steps


@dataclass(frozen=True, eq=False)
class Errors:
    """The plain fits, and what their errors are relative to."""

    free: plain_fit.FreeFit
    stated: plain_fit.StatedFit | None
    scale: Array  # (n,) the torque's own RMS about its mean, N·m
    friction: Array  # (P, n) part of the joints' power that friction takes in fits without a part

    @property
    def driven(self) -> Array:
        """Joints (n,) that friction clearly drives (-1), which it cannot do, or brakes (1)."""
        mean = self.friction.mean(axis=0)
        spread = np.sqrt(len(self.friction) - 1.0) * self.friction.std(axis=0)
        clear = np.abs(mean) > np.maximum(LEAST_POWER, CLEAR * spread)
        return np.asarray(np.sign(mean) * clear)

    @property
    def rms(self) -> Array:
        """(1 or 2, n) held-out errors of the free fit and, with stated inertias, theirs, N·m."""
        free = self.free.held_out
        return np.array([free] if self.stated is None else [free, self.stated.error])

    @property
    def relative(self) -> Array:
        """(1 or 2, n) errors, free and stated, as parts of the torque.

        Where the motion does not determine the free fit, the mean of the torque predicts better.
        """
        parts = self.rms / self.scale
        parts[0] = np.minimum(parts[0], 1.0)
        return np.maximum(parts, LEAST_RELATIVE)

    def score(self, base: Errors) -> float:
        """Return the sum of the logarithms of all errors relative to those of a base."""
        return float(np.sum(np.log(self.relative / base.relative)))


@dataclass(frozen=True, eq=False)
class Screen:
    """Robot and samples on which hypotheses are compared."""

    robot: Robot
    samples: plain_fit.Samples
    most: int = 300
    parts: bool = False
    stated_torque: bool = True
    known_arm: RigidArm | None = None
    _scores: dict[bytes, float] = field(default_factory=dict)

    @property
    def n(self) -> int:
        """Number of joints."""
        return self.robot.n

    @cached_property
    def arm(self) -> RigidArm:
        """The arm's base parameters and geometry."""
        return self.known_arm or RigidArm.of(self.robot)

    @cached_property
    def parameters(self) -> Array | None:
        """Stated base parameters (k,), or None without them."""
        if not (self.robot.has_inertia and self.stated_torque):
            return None
        return np.asarray(self.arm.combination @ self.robot.link_parameters)

    @cached_property
    def gravity(self) -> Array:
        """Gravity that the robot states (3,)."""
        return np.asarray(self.robot.gravity, dtype=float)

    @cached_property
    def thin(self) -> plain_fit.Samples:
        """At most ``most`` of the samples."""
        count = len(self.samples.t)
        step = -(-count // self.most)
        return self.samples.at(np.arange(step // 2, count, step)) if step > 1 else self.samples

    @cached_property
    def rigid(self) -> Array:
        """Rigid columns (4, n, k, N) without gravity, and of unit gravity along x, y and z."""
        s, still = self.thin, np.zeros((3 * len(self.thin.t), self.n))
        motion = (np.tile(s.q, (4, 1)), np.vstack([s.dq, still]), np.vstack([s.ddq, still]))
        gravity = np.repeat(np.eye(4)[1:], len(s.t), axis=1)
        made = self.arm.columns(*motion, gravity)
        return np.moveaxis(made.reshape(*made.shape[:2], 4, -1), 2, 0)

    @cached_property
    def weight(self) -> Array:
        """Torque (N, n) of the stated inertias under gravity, N·m; 0 without them."""
        if self.parameters is None:
            return np.zeros_like(self.thin.tau)
        columns = np.tensordot(self.gravity, self.rigid[1:], axes=1)
        return np.asarray(np.einsum("jkn,k->nj", columns, self.parameters))

    def columns(self, correction: Correction) -> Array:
        """Return rigid columns (n, k, N) under a correction."""
        gravity = self.gravity if correction.gravity is None else correction.gravity
        if correction.positions_stay:
            return np.asarray(self.rigid[0] + np.tensordot(gravity, self.rigid[1:], axes=1))
        return self.arm.columns(*correction.of_motion(self.thin), gravity)

    @cached_property
    def design(self) -> plain_fit.Design:
        """Columns of the samples as they are, which serve all hypotheses on the torque alone."""
        return self._design(Correction.none(self.n), self.thin)

    def _design(
        self, correction: Correction, s: plain_fit.Samples, columns: Array | None = None
    ) -> plain_fit.Design:
        columns = self.columns(correction) if columns is None else columns
        return plain_fit.design(columns, s, parts=self.parts)

    @cached_property
    def base(self) -> Errors:
        """Errors of the hypothesis that nothing is wrong."""
        return self.errors(Correction.none(self.n))

    @cached_property
    def displaced(self) -> Array:
        """RMS torque (n,), N·m, of stated centres of mass off by `COM_ERROR` along every axis."""
        if self.parameters is None:
            return np.zeros(self.n)
        links = self.robot.link_parameters.reshape(self.n, 10)
        moments = self.arm.combination.reshape(-1, self.n, 10)[:, :, 1:4] * links[:, :1]
        given = self.design.equations(self.thin.tau)
        size = np.einsum("kla,jkm,mla->j", moments, given.whole.matrix, moments, optimize=True)
        return np.asarray(COM_ERROR * np.sqrt(np.maximum(size, 0.0) / given.instants))

    def errors(self, correction: Correction, columns: Array | None = None) -> Errors:
        """Return the errors under a correction, whose columns (n, k, N) may be given."""
        if correction.torque_only:
            s, made = replace(self.thin, tau=self._torque(correction)), self.design
        else:
            s = self.thin if correction.signals_stay else correction.of_samples(self.thin)
            made = self._design(correction, s, columns)
        given = made.equations(s.tau)
        stated = None if self.parameters is None else plain_fit.stated_fit(given, self.parameters)
        fitted = plain_fit.free_fit(given)
        friction = np.zeros((1, self.n))
        if self.parts:
            own = fitted.own_without[:, :, plain_fit.FRICTION]
            friction = np.einsum("pjk,jk->pj", own, given.own_power(s))
        # errors are relative to the recorded torque, which adding a weight would enlarge
        scale = self.thin.spread if correction.weight else s.spread
        return Errors(fitted, stated, scale, friction)

    def _torque(self, correction: Correction) -> Array:
        """Return corrected torques, which are shifted before instants are left out."""
        if not correction.late:
            return correction.of_torque(self.thin) + correction.weight * self.weight
        s, tau = self.thin, self.thin.tau.copy()
        for rows, t, spline in self._splines:
            tau[rows] = spline(np.clip(s.t[rows] + correction.late, t[0], t[-1]))
        return np.asarray(tau @ correction.torque_matrix.T)

    @cached_property
    def _splines(self) -> list[tuple[Indices, Array, Callable[[Array], Array]]]:
        """Rows of each stretch that is compared, the stretch's time, and a spline of its torque."""
        whole = self.samples
        found: list[tuple[Indices, Array, Callable[[Array], Array]]] = []
        for stretch in np.unique(self.thin.segment):
            at = np.flatnonzero(whole.segment == stretch)
            t, tau = whole.t[at], whole.tau[at]
            if len(t) > 3:
                rows = np.flatnonzero(self.thin.segment == stretch)
                found.append((rows, t, CubicSpline(t, tau)))
        return found

    def scores(self, corrections: Sequence[Correction]) -> Array:
        """Return the scores of corrections: negative where errors fall.

        The columns of several are computed together.
        """
        new = {c.key: c for c in corrections if c.key not in self._scores}
        moved = [c for c in new.values() if not c.positions_stay and c.gravity is None]
        for batch in (moved[k : k + TOGETHER] for k in range(0, len(moved), TOGETHER)):
            motion = np.stack([c.of_motion(self.thin) for c in batch], axis=1)
            q, dq, ddq = motion.reshape(3, -1, self.n)
            made = self.arm.columns(q, dq, ddq, self.gravity)
            for c, columns in zip(batch, np.split(made, len(batch), axis=2), strict=True):
                self._scores[c.key] = self.errors(c, columns).score(self.base)
        for key, c in new.items():
            if key not in self._scores:
                self._scores[key] = self.errors(c).score(self.base)
        return np.array([self._scores[c.key] for c in corrections])


def best_on(function: Callable[[Array], Array], grid: Array, *, rounds: int = 2) -> float:
    """Return the grid's best value, refined by parabolas through its neighbours."""
    values = function(grid)
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
        xs = best + step + np.array([-width, 0.0, width])
        fs = function(xs)
        if fs.min() < low:
            best, low = float(xs[np.argmin(fs)]), float(fs.min())
    return best
