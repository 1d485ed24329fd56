"""Newton-Euler recursion on twists and wrenches (Luo et al. 2024, Eqs. 2-3, corrected).

The corrections, a sign in Eq. 2 and an inverse in Eq. 3, are explained in
``examples/paper/stacked_form.py``.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import reduce
from itertools import accumulate
from operator import matmul

import casadi as ca

from lieid_casadi.dynamics.lie import (
    Motion,
    Pose,
    axes,
    constant,
    cross,
    hat,
    inverse_adjoint_transpose_times,
    relative_poses,
    tool_pose,
)
from lieid_casadi.robot.robot import Robot


@dataclass(frozen=True)
class ReferenceMotion:
    """A second motion q̇_r, q̈_r (n,) through the same pose."""

    dq: ca.SX
    ddq: ca.SX


@dataclass(frozen=True)
class LinkAcceleration:
    """Accelerations of one link, expressed in its frame: a + K·r at the point r, K = α̂ + ω̂².

    ``angular_acceleration`` is α (3,), ``centripetal`` ω̂² (3, 3), ``acceleration`` that of the
    frame's origin (3,) relative to free fall (A₀ = [0; −g] includes gravity).
    """

    angular_acceleration: ca.SX
    centripetal: ca.SX
    acceleration: ca.SX

    @property
    def gradient(self) -> ca.SX:
        """K (3, 3), the change of acceleration per distance from the origin."""
        return hat(self.angular_acceleration) + self.centripetal


def link_accelerations(
    robot: Robot,
    motion: Motion,
    *,
    reference: ReferenceMotion | None = None,
    gravity: ca.SX | None = None,
) -> list[LinkAcceleration]:
    """Forward recursion, Eq. 2, on the accelerations of points instead of twists.

    V_i = Ad⁻¹V_{i−1} + ξq̇ and A_i = Ad⁻¹A_{i−1} + ad_{Ad⁻¹V}(ξq̇) + ξq̈, with the origin's
    acceleration A_v + ω × v in place of A_v, which makes linear velocities unnecessary.

    With a reference, q̈ is q̈_r and every product of two velocities becomes half the sum of the two
    mixed products: the bilinear form whose torque is C(q, q̇)·q̇_r with Ṁ − 2C skew-symmetric.

    ``gravity`` (3,): in the base frame, m/s²; the robot's if left out.
    """
    rates = [motion.dq] if reference is None else [motion.dq, reference.dq]
    ddq = motion.ddq if reference is None else reference.ddq
    omega = [ca.SX(3, 1)] * len(rates)
    free_fall = constant(-robot.gravity) if gravity is None else -gravity
    body = LinkAcceleration(ca.SX(3, 1), ca.SX(3, 3), free_fall)
    bodies = []
    for i, (g, xi) in enumerate(zip(relative_poses(robot, motion), axes(robot), strict=True)):
        back = g.rotation.T
        turns, slides = [xi[:3] * dq[i] for dq in rates], [xi[3:] * dq[i] for dq in rates]
        carried = [ca.mtimes(back, w) for w in omega]
        omega = [w + turn for w, turn in zip(carried, turns, strict=True)]
        at_joint = body.acceleration + ca.mtimes(body.gradient, g.translation)
        body = LinkAcceleration(
            ca.mtimes(back, body.angular_acceleration)
            + _mixed(cross, carried, turns)
            + xi[:3] * ddq[i],
            _mixed(_centripetal, omega, omega),
            ca.mtimes(back, at_joint)
            + 2 * _mixed(cross, carried, slides)
            + _mixed(cross, turns, slides)
            + xi[3:] * ddq[i],
        )
        bodies.append(body)
    return bodies


def _mixed(
    product: Callable[[ca.SX, ca.SX], ca.SX], a: Sequence[ca.SX], b: Sequence[ca.SX]
) -> ca.SX:
    """Return a product of two velocities of one motion, or the mean of the two mixed ones."""
    if len(a) == 1:
        return product(a[0], b[0])
    return (product(a[0], b[1]) + product(a[1], b[0])) / 2


def _centripetal(w: ca.SX, u: ca.SX) -> ca.SX:
    """Return (ŵ·û + û·ŵ)/2 (3, 3), ω̂² for w = u = ω, with its symmetry in the expressions."""
    product = ca.mtimes(hat(w), hat(u))
    if w is not u:
        product = (product + product.T) / 2
    return ca.triu2symm(ca.triu(product))


def link_wrench(link: ca.SX, body: LinkAcceleration) -> ca.SX:
    """Return E·A − ad_Vᵀ·(E·V) (6,), the wrench that moves a link with parameters (10,).

    The inertia's moment I·α + ω × I·ω is written in K and ω̂², which the force needs anyway.
    """
    moment, gradient = link[1:4], body.gradient
    force = link[0] * body.acceleration + ca.mtimes(gradient, moment)
    return ca.vertcat(
        ca.mtimes(inertia_moments(body), link[4:10]) + cross(moment, body.acceleration), force
    )


def inertia_moments(body: LinkAcceleration) -> ca.SX:
    """Return (3, 6), I·α + ω × I·ω per element of the inertia: xx, xy, yy, xz, yz, zz."""
    x, y, z = 0, 1, 2
    alpha, k, s = body.angular_acceleration, body.gradient, body.centripetal
    return ca.vertcat(
        ca.horzcat(alpha[x], -k[z, x], -s[y, z], k[y, x], k[y, y] - k[z, z], s[y, z]),
        ca.horzcat(s[x, z], k[z, y], alpha[y], k[z, z] - k[x, x], -k[x, y], -s[x, z]),
        ca.horzcat(-s[x, y], k[x, x] - k[y, y], s[x, y], -k[y, z], k[x, z], alpha[z]),
    )


def inverse_dynamics(
    robot: Robot, motion: Motion, parameters: ca.SX, *, gravity: ca.SX | None = None
) -> ca.SX:
    """Return the rigid torque (n,) of link parameters (10 n,) by the backward recursion, Eq. 3."""
    poses, xi = relative_poses(robot, motion), axes(robot)
    wrench, torque = ca.SX(6, 1), [ca.SX(1, 1)] * robot.n
    bodies = link_accelerations(robot, motion, gravity=gravity)
    for i in reversed(range(robot.n)):
        wrench = wrench + link_wrench(parameters[10 * i : 10 * i + 10], bodies[i])
        torque[i] = ca.mtimes(xi[i].T, wrench)
        wrench = inverse_adjoint_transpose_times(poses[i], wrench)
    return ca.vertcat(*torque)


def tool_in_base(robot: Robot, motion: Motion) -> Pose:
    """Return the tool's pose in the base frame.

    The first joint is multiplied last: parallel axes after a vertical first one, as a UR10e has,
    then take fewer operations (87 in place of 112).
    """
    first, *others = [*relative_poses(robot, motion), tool_pose(robot)]
    return first @ reduce(matmul, others)


def link_poses(robot: Robot, motion: Motion) -> list[Pose]:
    """Return each link frame in the base frame."""
    return list(accumulate(relative_poses(robot, motion), matmul))
