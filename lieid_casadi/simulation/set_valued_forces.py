"""Set-valued forces within a time step: dry friction, and the contact at the sides of a play."""

from __future__ import annotations

from typing import Any

import casadi as ca

SWEEPS = 30  # of the projected Gauss-Seidel iteration, which starts from the step before
RETURN = 0.2  # of a link's way beyond its play, made up for in each step


def set_valued_forces(
    free: ca.SX,
    gain: ca.SX,
    level: ca.SX,
    bounds: tuple[ca.SX, ca.SX],
    start: ca.SX,
) -> ca.SX:
    """Return the forces (n + P,) of dry friction and contact, N·m.

    The first n belong to the velocities of motors. Dry friction λ satisfies |λ| ≤ level, opposing
    the velocity at the end of the step or holding the joint. The others belong to the velocities
    of motors relative to their links: λ keeps these within what the play leaves, and is zero
    inside of it (Moreau, "Unilateral contact and dry friction", 1988).

    ``free`` (n + P,): velocities at the end of the step without these forces; ``gain`` (n + P, n +
    P): change of velocity per force; ``level`` (n,): largest friction, N·m; ``bounds``: least and
    largest relative velocity; ``start`` (n + P,): forces of the step before.
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

    ``twist`` (P,): angle of the motors minus that of their links, rad; ``half`` (P,): half of the
    play, rad; ``h``: step, s.
    """
    upper, lower = half - twist, -half - twist
    return (
        ca.if_else(lower < 0.0, lower, RETURN * lower) / h,
        ca.if_else(upper > 0.0, upper, RETURN * upper) / h,
    )


def clip(x: Any, lower: Any, upper: Any) -> Any:
    """Return x within bounds.

    ``x``, ``lower``, ``upper``: numbers or symbols.
    """
    return ca.fmin(ca.fmax(x, lower), upper)
