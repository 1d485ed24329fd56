"""Friction of a fit as MuJoCo's damping and frictionloss, with the error of that form."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import nnls

from lieid_casadi.arrays import Array
from lieid_casadi.compiled import Compiled, compile
from lieid_casadi.effects import ArmEffect
from lieid_casadi.friction_curves.constant_speed import steady_columns
from lieid_casadi.identification.fit import Fit
from lieid_casadi.model import Model

SAMPLES = 400  # of speed, load and position, at which friction is evaluated
SPEEDS = (0.02, 0.5)  # of the joint's velocity limit, from and to
UNKNOWN_SPEED = 2.0  # rad/s, velocity limit of a robot that states none
WARM = 1e6  # s since the start, at which warm-up has ended
EXACT = 1e-9  # relative error of friction that MuJoCo has itself


@dataclass(frozen=True)
class MujocoFriction:
    """Friction of one joint as damping·q̇ + frictionloss·sgn(q̇), neither of them negative.

    ``error`` is the RMS of the difference from the model's friction, N·m, and ``share`` the same in
    parts of the RMS friction.
    """

    damping: float
    frictionloss: float
    error: float
    share: float

    @property
    def exact(self) -> bool:
        """Whether MuJoCo has all of the friction."""
        return self.share < EXACT


def mujoco_friction(fit: Fit) -> tuple[MujocoFriction, ...]:
    """Return the friction of all joints by non-negative least squares.

    The model's friction (half the difference between forward and backward motion in steady
    state) is evaluated at speeds that are uniform from 2 to 50 % of the joint's velocity limit, at
    random poses within the position limits, under the load of the links at these poses and at
    rest.
    """
    robot = fit.model.robot
    random = np.random.default_rng(0)
    lower, upper = robot.limit("position_lower"), robot.limit("position_upper")
    lower, upper = np.nan_to_num(lower, nan=-np.pi), np.nan_to_num(upper, nan=np.pi)
    q = random.uniform(lower, upper, (SAMPLES, robot.n))
    load = fit.compiled.inverse_dynamics(q, 0.0 * q, 0.0 * q, fit.link_parameters)
    limit = robot.limit("velocity")
    limit = np.where(np.isfinite(limit), limit, UNKNOWN_SPEED)
    shares = np.linspace(*SPEEDS, SAMPLES)
    whole = np.array([isinstance(p.effect, ArmEffect) for p in fit.model.placements], dtype=bool)
    placed = zip(fit.model.placements, whole, strict=True)
    model = Model.of_placements(robot, [p for p, other in placed if not other])
    widths = np.array([len(p.effect.coefficients) for p in fit.model.placements], dtype=int)
    coefficients = fit.effect_coefficients[~np.repeat(whole, widths)]
    owned = np.array([len(p.effect.shapes) for p in fit.model.placements], dtype=int)
    friction = _Friction(compile(model), coefficients, fit.shapes[~np.repeat(whole, owned)])
    return tuple(
        _of_joint(friction, j, shares * limit[j], load[:, j], q[:, j]) for j in range(robot.n)
    )


@dataclass(frozen=True, eq=False)
class _Friction:
    """Effects on single joints: their functions, coefficients (m,) and shape parameters (s,)."""

    compiled: Compiled
    coefficients: Array
    shapes: Array


def _of_joint(own: _Friction, joint: int, speed: Array, load: Array, q: Array) -> MujocoFriction:
    """Return the friction of one joint.

    ``joint``: from 0; ``speed``, ``load``, ``q`` (P,): rad/s, N·m, rad.
    """
    if not len(own.coefficients):
        return MujocoFriction(0.0, 0.0, 0.0, 0.0)
    columns = steady_columns(
        own.compiled, joint, speed, own.shapes, load=load, position=q, time=WARM
    )
    friction = columns @ own.coefficients
    (damping, loss), _ = nnls(np.column_stack([speed, np.ones_like(speed)]), friction)
    error = float(np.sqrt(np.mean((damping * speed + loss - friction) ** 2)))
    size = float(np.sqrt(np.mean(friction**2)))
    return MujocoFriction(float(damping), float(loss), error, error / size if size else 0.0)
