"""One time step of an arm: implicit in drives and viscous friction, with sticking joints."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np

from lieid_casadi.effects.deadband import Deadband
from lieid_casadi.effects.signals import EffectSignals
from lieid_casadi.expressions.torque import TorqueExpressions, Values
from lieid_casadi.identification.fit import Fit
from lieid_casadi.robot import Drive

SWEEPS = 30  # of the projected Gauss-Seidel iteration, which starts from the step before
IMPLICIT = 0.55  # share of the velocity at the end of the step: 0.5 is second order, 1 damps most
STATE = ("q", "dq", "ddq", "dry", "states")


@dataclass(frozen=True, eq=False)
class _Forces:
    """Expressions at an instant: forces without dry friction, its level, and their derivatives."""

    force: ca.SX
    level: ca.SX
    by_q: ca.SX
    by_dq: ca.SX


def step_function(fit: Fit, drives: Sequence[Drive] | None) -> ca.Function:
    """Return the step ``(state, input, temperature, time, h) -> state``.

    The scheme is drift-kick-drift: forces act at q + h/2·q̇. Drives and viscous friction are
    linearly implicit, M − θ·h·∂f/∂q̇ − θ²·h²·∂f/∂q being the matrix of the change of velocity. Dry
    friction λ satisfies |λ_i| ≤ level_i, with −λ_i opposing the velocity at the end of the step,
    or holding the joint: a box-constrained complementarity problem, solved by projected
    Gauss-Seidel sweeps (Moreau, "Unilateral contact and dry friction", 1988). Its level follows
    from the load at the acceleration of the step before.

    Parameters
    ----------
    fit : Fit
    drives : sequence of Drive, length n, or None
        Control laws: the input is the commanded position; None: it is the torque.

    Returns
    -------
    ca.Function
        ``state`` is [q; dq; ddq; dry; states].
    """
    model, n = fit.model, fit.model.n
    numbers = (fit.link_parameters, fit.effect_coefficients, fit.shapes)
    links, effects, shapes = (ca.SX(ca.DM(x)) for x in numbers)
    values = Values(links, effects, shapes, False, fit.temperature_mean)
    sign = ca.SX.sym("sign", n)
    error = None if drives is None else ca.SX.sym("error", n)
    torque = TorqueExpressions(
        model, values, None, as_measured=False, payload=False, sign=sign, command_error=error
    )
    m = torque.motion
    before = ca.SX.sym("before", n)  # acceleration of the last step
    dry = ca.SX.sym("dry", n)
    given, h = ca.SX.sym("input", n), ca.SX.sym("h")
    start = ca.SX.sym("q", n)
    at = _forces(torque, sign, error, given, drives)
    mass = ca.substitute(torque.mass_matrix, m.ddq, ca.SX.zeros(n))
    matrix = mass - IMPLICIT * h * at.by_dq - (IMPLICIT * h) ** 2 * at.by_q
    inverse = ca.solve(ca.densify(matrix), ca.SX.eye(n))
    free = m.dq + ca.mtimes(inverse, h * at.force)
    velocity, level = _with_dry_friction(free, h * inverse, at.level, dry)
    half = start + 0.5 * h * m.dq
    after = [
        half + 0.5 * h * velocity, velocity, (velocity - m.dq) / h, level,
        _states(torque, values, start, half, velocity, h),
    ]  # fmt: skip
    load = ca.substitute(torque.rigid_torque, m.ddq, before)
    result = ca.substitute(ca.vertcat(*after), torque.load, load)
    result = ca.substitute(result, m.q, half)
    state = ca.vertcat(start, m.dq, before, dry, torque.states)
    inputs = [state, given, torque.temperature, torque.time, h]
    names = ["state", "input", "temperature", "time", "h"]
    return ca.Function("step", inputs, [ca.densify(result)], names, ["after"], {"cse": True})


def _forces(
    torque: TorqueExpressions,
    sign: ca.SX,
    error: ca.SX | None,
    given: ca.SX,
    drives: Sequence[Drive] | None,
) -> _Forces:
    """Return the forces of drives, links and friction at q, dq.

    Parameters
    ----------
    torque : TorqueExpressions
    sign : (n,)
        Its symbol for the sign of the velocity.
    error : (n,) or None
        Its symbol for the commanded minus the measured position.
    given : (n,)
        Torque, or commanded position.
    drives : sequence of Drive or None
    """
    m, n = torque.motion, torque.n
    zero = ca.SX.zeros(n)
    friction = ca.substitute(torque.joint_torque, m.ddq, zero)
    if error is not None:
        friction = ca.substitute(friction, error, given - m.q)
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
        driven = ca.vertcat(*(law.torque(e, v, clip=_clip) for law, e, v in laws))
    bias = ca.substitute(torque.rigid_torque + torque.arm_torque, m.ddq, zero)
    implicit = driven - smooth
    return _Forces(
        force=driven - smooth - bias,
        level=level,
        by_q=ca.jacobian(implicit, m.q),
        by_dq=ca.jacobian(implicit, m.dq),
    )


def _beyond_deadband(torque: TorqueExpressions, error: ca.SX) -> list[ca.SX]:
    """Return the position errors (n) that the controllers react to, from all errors (n,)."""
    errors = ca.vertsplit(error)
    for k, column in enumerate(torque.model.columns):
        if column.name == f"{Deadband.name}.d":
            band, own = torque.values.effects[k], errors[column.joint]
            errors[column.joint] = own - _clip(own, -band, band)
    return list(errors)


def _clip(x: Any, lower: Any, upper: Any) -> Any:
    return ca.fmin(ca.fmax(x, lower), upper)


def _with_dry_friction(free: ca.SX, gain: ca.SX, level: ca.SX, start: ca.SX) -> tuple[ca.SX, ca.SX]:
    """Return the velocity with dry friction, and that friction (n,) each.

    Parameters
    ----------
    free : (n,)
        Velocity at the end of the step without dry friction.
    gain : (n, n)
        Change of velocity per torque.
    level : (n,)
        Largest friction, N·m.
    start : (n,)
        Friction of the step before.
    """
    n = free.size1()
    dry = ca.fmin(ca.fmax(start, -level), level)
    for _ in range(SWEEPS):
        for i in range(n):
            velocity = free[i] - ca.mtimes(gain[i, :], dry)
            dry[i] = _clip(dry[i] + velocity / gain[i, i], -level[i], level[i])
    return free - ca.mtimes(gain, dry), dry


def _states(
    torque: TorqueExpressions, values: Values, start: ca.SX, half: ca.SX, velocity: ca.SX, h: ca.SX
) -> ca.SX:
    """Return the states of effects with memory at the end of the step.

    Parameters
    ----------
    torque : TorqueExpressions
    values : Values
    start, half : (n,)
        Positions at the start and in the middle of the step.
    velocity : (n,)
        At its end.
    h : scalar
        Length of the step, s.
    """
    if not torque.states.size1():
        return torque.states
    m, t = torque.motion, torque.time
    zero = ca.SX.zeros(torque.n)

    def signals(q: ca.SX, dq: ca.SX, time: ca.SX) -> EffectSignals:
        return EffectSignals(q, dq, zero, ca.sign(dq), torque.load, torque.temperature, time)

    end = half + 0.5 * h * velocity
    return torque.model.advance(
        signals(start, m.dq, t), signals(end, velocity, t + h), values.shapes, torque.states
    )


def initial_state(fit: Fit, q: np.ndarray[Any, Any], dq: np.ndarray[Any, Any]) -> Any:
    """Return the states (d, W) at the start of W windows, without friction and memory.

    Parameters
    ----------
    fit : Fit
    q, dq : (W, n)
        Measured position and velocity, rad and rad/s.
    """
    windows = len(q)
    states = np.repeat(fit.model.initial_states[:, None], windows, axis=1)
    return np.concatenate([q.T, dq.T, np.zeros((2 * fit.model.n, windows)), states])
