"""One time step of an arm: implicit in drives and viscous friction, with set-valued forces.

Motors may move apart from their links within a play.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np

from lieid_casadi.arrays import Array
from lieid_casadi.effects.backlash import Backlash, motor_in_play
from lieid_casadi.effects.deadband import Deadband
from lieid_casadi.effects.effect import EffectSignals
from lieid_casadi.expressions.torque import TorqueExpressions, Values
from lieid_casadi.identification.fit import Fit
from lieid_casadi.identification.regression.segment_columns import model_along
from lieid_casadi.recording import Processed
from lieid_casadi.robot import Drive

LARGEST = Backlash.coefficients[0].limit  # rad


@dataclass(frozen=True)
class Play:
    """Play of one joint (from 0), rad."""

    joint: int
    width: float


def plays_of(fit: Fit) -> tuple[Play, ...]:
    """Return the plays of a fit, of joints whose motor has an inertia of its own (armature).

    Without one, nothing defines how a motor moves apart from its link. A play above the limit of
    the effect is that of a recording in which the load keeps its sign, and is left out.
    """
    found = {(c.name, c.joint): float(v) for c, v in zip(
        fit.model.columns, fit.effect_coefficients, strict=True
    )}  # fmt: skip
    plays = (
        Play(p.joint, found[f"{Backlash.name}.b", p.joint])
        for p in fit.model.placements
        if isinstance(p.effect, Backlash)
    )
    return tuple(
        play
        for play in plays
        if 0.0 < play.width <= LARGEST and found.get(("armature.I_a", play.joint), 0.0) > 0.0
    )


@dataclass(frozen=True, eq=False)
class Coordinates:
    """Coordinates (d): the angles of the motors (n), then those of the links with play (P)."""

    motors: Array  # (n, d) angles of the motors from the coordinates
    links: Array  # (n, d) the same of the links; equal on joints without play
    plays: tuple[Play, ...]

    @classmethod
    def of(cls, fit: Fit) -> Coordinates:
        """Return the coordinates of a fit."""
        n, plays = fit.model.n, plays_of(fit)
        motors = np.eye(n, n + len(plays))
        links = motors.copy()
        for k, play in enumerate(plays):
            links[play.joint] = 0.0
            links[play.joint, n + k] = 1.0
        return cls(motors, links, plays)

    @property
    def size(self) -> int:
        """Number of coordinates, d."""
        return len(self.motors.T)

    @property
    def twists(self) -> Array:
        """(P, d): angle of the motors minus that of their links, from the coordinates."""
        return (self.motors - self.links)[[play.joint for play in self.plays]]

    def along(self, fit: Fit, segment: Processed) -> tuple[Array, Array]:
        """Return coordinates (K, d) and velocities along a segment, whose motors are measured.

        The place of the links in their play is that of `lieid_casadi.effects.backlash`.
        """
        arm = model_along(fit.compiled, segment, fit.shapes, fit.parameters, fitted=False)
        q, dq = [segment.q], [segment.dq]
        for play in self.plays:
            place = motor_in_play(arm, play.joint, play.width)[:, None]
            q.append(segment.q[:, [play.joint]] - place)
            dq.append(segment.dq[:, [play.joint]] - np.gradient(place, segment.t, axis=0))
        return np.hstack(q), np.hstack(dq)


SWEEPS = 30  # of the projected Gauss-Seidel iteration, which starts from the step before
RETURN = 0.2  # of a link's way beyond its play, made up for in each step


def set_valued_forces(
    free: ca.SX, gain: ca.SX, level: ca.SX, bounds: tuple[ca.SX, ca.SX], start: ca.SX
) -> ca.SX:
    """Return the forces (n + P,) of dry friction and contact, N·m.

    The first n belong to the velocities of motors. Dry friction λ satisfies |λ| ≤ ``level`` (n,),
    opposing the velocity at the end of the step or holding the joint. The others belong to the
    velocities of motors relative to their links: λ keeps these within ``bounds``, which the play
    leaves, and is zero inside of it (Moreau, "Unilateral contact and dry friction", 1988).

    ``free`` are the velocities at the end of the step without these forces, ``gain`` their change
    per force, ``start`` the forces of the step before.
    """
    n = level.size1()
    forces = ca.SX(start)
    for i in range(n):
        forces[i] = clip(start[i], -level[i], level[i])
    for _ in range(SWEEPS):
        for i in range(free.size1()):
            without = free[i] - ca.mtimes(gain[i, :], forces) + gain[i, i] * forces[i]
            if i < n:
                forces[i] = clip(without / gain[i, i], -level[i], level[i])
            else:
                allowed = clip(without, bounds[0][i - n], bounds[1][i - n])
                forces[i] = (without - allowed) / gain[i, i]
    return forces


def allowed_velocities(twist: ca.SX, half: ca.DM, h: ca.SX) -> tuple[ca.SX, ca.SX]:
    """Return the least and the largest velocity (P,) of motors relative to their links.

    ``twist`` (P,) is the angle of the motors minus that of their links, ``half`` half of the play.
    """
    upper, lower = half - twist, -half - twist
    return (
        ca.if_else(lower < 0.0, lower, RETURN * lower) / h,
        ca.if_else(upper > 0.0, upper, RETURN * upper) / h,
    )


def clip(x: Any, lower: Any, upper: Any) -> Any:
    """Return x, a number or symbol, within bounds."""
    return ca.fmin(ca.fmax(x, lower), upper)


IMPLICIT = 0.55  # share of the velocity at the end of the step: 0.5 is second order, 1 damps most


def step_function(fit: Fit, drives: Sequence[Drive] | None) -> ca.Function:
    """Return the step ``(state, input, temperature, time, h, numbers) -> state``.

    The scheme is drift-kick-drift: forces act at x + h/2·ẋ, x being the angles of the motors and
    those of the links with play. Drives and viscous friction act on motors and are linearly
    implicit, M − θ·h·∂f/∂ẋ − θ²·h²·∂f/∂x being the matrix of the change of velocity. Dry friction
    and the contact at the sides of a play are set-valued forces. The level of dry friction follows
    from the load at the acceleration of the step before.

    The input is the commanded position, or without ``drives`` the torque; the ``numbers``
    (10 n + m + s,) are link parameters, coefficients and shape parameters; the widths of plays are
    those of the fit. ``state`` is [x; ẋ; ẍ; set-valued forces; states of effects with memory].
    """
    model, n, x = fit.model, fit.model.n, Coordinates.of(fit)
    counts = [0, 10 * n, len(fit.parameters), len(fit.parameters) + len(fit.shapes)]
    numbers = ca.SX.sym("numbers", counts[-1])
    links, effects, shapes = ca.vertsplit(numbers, counts)
    values = Values(links, effects, shapes, False, fit.temperature_mean)
    sign = ca.SX.sym("sign", n)
    error = None if drives is None else ca.SX.sym("error", n)
    torque = TorqueExpressions(
        model, values, None, as_measured=False, payload=False, sign=sign, command_error=error
    )
    m = torque.motion
    to_motors, to_links, to_twists = (ca.sparsify(ca.DM(a)) for a in (x.motors, x.links, x.twists))
    half_plays = ca.DM([0.5 * play.width for play in x.plays])
    start, speed = ca.SX.sym("position", x.size), ca.SX.sym("speed", x.size)
    before = ca.SX.sym("before", x.size)  # acceleration of the last step
    held = ca.SX.sym("held", n + len(x.plays))
    given, h = ca.SX.sym("input", n), ca.SX.sym("h")
    half = start + 0.5 * h * speed

    def at(angles: ca.DM, *expressions: ca.SX) -> list[ca.SX]:
        """Return expressions of q, dq and ddq at angles (n, d) of the coordinates."""
        own = [ca.mtimes(angles, y) for y in (half, speed, before)]
        found: list[ca.SX] = ca.substitute(list(expressions), [m.q, m.dq, m.ddq], own)
        return found

    motor, level, bias = _forces(torque, sign, error, given, drives)
    armature = ca.substitute(torque.armature, sign, ca.sign(m.dq))
    by_q, by_dq = ca.jacobian(motor, m.q), ca.jacobian(motor, m.dq)
    implicit = armature - IMPLICIT * h * by_dq - (IMPLICIT * h) ** 2 * by_q
    motor, level, implicit = at(to_motors, motor, level, implicit)
    bias, rigid, load = at(to_links, bias, torque.rigid_mass_matrix, torque.rigid_torque)
    matrix = to_links.T @ rigid @ to_links + to_motors.T @ implicit @ to_motors
    inverse = ca.solve(ca.densify(matrix), ca.SX.eye(x.size))
    free = speed + h * (inverse @ (to_motors.T @ motor - to_links.T @ bias))
    rows = ca.vertcat(to_motors, to_twists)
    bounds = allowed_velocities(to_twists @ half, half_plays, h)
    forces = set_valued_forces(rows @ free, h * (rows @ inverse @ rows.T), level, bounds, held)
    velocity = free - h * (inverse @ (rows.T @ forces))
    end = half + 0.5 * h * velocity
    after = [
        end, velocity, (velocity - speed) / h, forces,
        _states(torque, values, (to_motors @ start, to_motors @ speed),
                (to_motors @ end, to_motors @ velocity), h),
    ]  # fmt: skip
    result = ca.substitute(ca.vertcat(*after), torque.load, load)
    state = ca.vertcat(start, speed, before, held, torque.states)
    inputs = [state, given, torque.temperature, torque.time, h, numbers]
    names = ["state", "input", "temperature", "time", "h", "numbers"]
    return ca.Function("step", inputs, [ca.densify(result)], names, ["after"], {"cse": True})


def _forces(
    torque: TorqueExpressions,
    sign: ca.SX,
    error: ca.SX | None,
    given: ca.SX,
    drives: Sequence[Drive] | None,
) -> tuple[ca.SX, ca.SX, ca.SX]:
    """Return three kinds of forces (n,) as expressions of q and dq.

    They are the torque of drives minus friction without its dry part, the size of that part, and
    the torque of the links without acceleration. ``sign`` and ``error`` (n,) are symbols of
    ``torque`` for the signs of the velocities and the commanded minus the measured positions;
    ``given`` (n,) is the torque, or commanded position.
    """
    m, n = torque.motion, torque.n
    zero = ca.SX.zeros(n)
    friction = ca.substitute(torque.joint_torque, m.ddq, zero)
    if error is not None and drives is not None:
        pairs = zip(drives, ca.vertsplit(given - m.q), ca.vertsplit(m.dq), strict=True)
        acting = ca.vertcat(*(law.effective_error(e, v, clip=clip) for law, e, v in pairs))
        friction = ca.substitute(friction, error, acting)
    now = ca.sign(m.dq)
    sides = []
    for side in (1.0, -1.0):
        parts = []
        for i in range(n):
            own = ca.SX(now)
            own[i] = side
            parts.append(ca.substitute(friction[i], sign, own))
        sides.append(ca.vertcat(*parts))
    smooth, level = 0.5 * (sides[0] + sides[1]), ca.fmax(0.5 * (sides[0] - sides[1]), 0.0)
    driven = given
    if drives is not None:
        errors = _beyond_deadband(torque, given - m.q)
        laws = zip(drives, errors, ca.vertsplit(m.dq), strict=True)
        driven = ca.vertcat(*(law.torque(e, v, clip=clip) for law, e, v in laws))
    bias = ca.substitute(torque.rigid_torque + torque.arm_torque, m.ddq, zero)
    return driven - smooth, level, bias


def _beyond_deadband(torque: TorqueExpressions, error: ca.SX) -> list[ca.SX]:
    """Return the position errors (n) that the controllers react to, from all errors (n,)."""
    errors = ca.vertsplit(error)
    for k, column in enumerate(torque.model.columns):
        if column.name == f"{Deadband.name}.d":
            band, own = torque.values.effects[k], errors[column.joint]
            errors[column.joint] = own - clip(own, -band, band)
    return list(errors)


def _states(
    torque: TorqueExpressions,
    values: Values,
    start: tuple[ca.SX, ca.SX],
    end: tuple[ca.SX, ca.SX],
    h: ca.SX,
) -> ca.SX:
    """Return the states of effects with memory at the end of the step.

    ``start``, ``end``: positions and velocities of the motors at both ends of the step.
    """
    if not torque.states.size1():
        return torque.states
    t, zero = torque.time, ca.SX.zeros(torque.n)

    def signals(q: ca.SX, dq: ca.SX, time: ca.SX) -> EffectSignals:
        return EffectSignals(q, dq, zero, ca.sign(dq), torque.load, torque.temperature, time)

    return torque.model.advance(
        signals(*start, t), signals(*end, t + h), values.shapes, torque.states
    )


def initial_state(fit: Fit, x: np.ndarray[Any, Any], dx: np.ndarray[Any, Any]) -> Any:
    """Return the states (·, W) at the start of W windows, without friction and memory.

    ``x``, ``dx`` (W, d): angles of motors and links with play, rad, and their velocities, rad/s.
    """
    windows, d = x.shape
    rest = np.zeros((2 * d, windows))
    states = np.repeat(fit.model.initial_states[:, None], windows, axis=1)
    return np.concatenate([x.T, dx.T, rest, states])
