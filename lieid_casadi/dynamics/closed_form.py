"""Closed form of the dynamics: M, C, G and J as expressions (Luo et al. 2024, Eqs. 4-5).

The products of the paper's stacked matrices (``examples/paper/stacked_form.py``) are evaluated
block by block, without their zeros. Link parameters are vectors (10 n,).
"""

from __future__ import annotations

import casadi as ca

from lieid_casadi.dynamics.lie import (
    Motion,
    Pose,
    axes,
    cross,
    hat,
    inverse_adjoint_times,
    inverse_adjoint_transpose_times,
    relative_poses,
    small_adjoint,
    tool_pose,
)
from lieid_casadi.dynamics.recursion import inverse_dynamics, link_poses
from lieid_casadi.robot.robot import Robot


def spatial_inertia(link: ca.SX) -> ca.SX:
    """Return E (6, 6) = [[I, m·ĉ], [−m·ĉ, m·1₃]] at the link frame's origin."""
    moment, mass = hat(link[1:4]), link[0] * ca.SX(ca.DM.eye(3))
    return ca.vertcat(ca.horzcat(_inertia(link), moment), ca.horzcat(-moment, mass))


def _inertia(link: ca.SX) -> ca.SX:
    """Return the inertia (3, 3) about the link frame's origin."""
    return ca.vertcat(
        ca.horzcat(link[4], link[5], link[7]),
        ca.horzcat(link[5], link[6], link[8]),
        ca.horzcat(link[7], link[8], link[9]),
    )


def _links(parameters: ca.SX) -> list[ca.SX]:
    return [parameters[k : k + 10] for k in range(0, parameters.shape[0], 10)]


def mass_matrix(robot: Robot, motion: Motion, parameters: ca.SX) -> ca.SX:
    """Return M(q) = ξᵀBᵀEBξ (n, n).

    Summed from the tip: the links from j on move as one body when joint j alone moves (composite
    rigid bodies; Featherstone, "Rigid Body Dynamics Algorithms", 2008, ch. 6).
    """
    matrix, links = ca.SX(robot.n, robot.n), _links(parameters)
    poses, xi = relative_poses(robot, motion), axes(robot)
    body = links[-1]
    for j in reversed(range(robot.n)):
        wrench = ca.mtimes(spatial_inertia(body), xi[j])
        for i in reversed(range(j + 1)):
            matrix[i, j] = matrix[j, i] = ca.mtimes(xi[i].T, wrench)
            wrench = inverse_adjoint_transpose_times(poses[i], wrench)
        if j:
            body = links[j - 1] + seen_from_parent(poses[j], body)
    return matrix


def seen_from_parent(g: Pose, link: ca.SX) -> ca.SX:
    """Return link parameters (10,) about the parent's frame, given the link's pose in it."""
    mass, moment = link[0], ca.mtimes(g.rotation, link[1:4])
    p, turned = hat(g.translation), hat(moment)
    inertia = ca.mtimes(g.rotation, ca.mtimes(_inertia(link), g.rotation.T))
    across = ca.mtimes(p, turned)
    inertia = inertia - across - across.T - mass * ca.mtimes(p, p)
    six = [inertia[i, j] for i, j in ((0, 0), (0, 1), (1, 1), (0, 2), (1, 2), (2, 2))]
    return ca.vertcat(mass, moment + mass * g.translation, *six)


def coriolis_matrix(robot: Robot, motion: Motion, parameters: ca.SX) -> ca.SX:
    """Return C(q, q̇) (n, n), whose C·q̇ is the Coriolis torque, with Ṁ − 2C skew-symmetric.

    C = Σ Jᵀ(E·J̇ + B·J) with B(E, V)·V_r the forces m·ω_r × u on points that move with u, summed
    from the tip as in `mass_matrix`; Echeandia & Wensing, "Numerical methods to compute the
    Coriolis matrix and Christoffel symbols for rigid-body systems", J. Comput. Nonlinear Dynam.
    2021. B = [[L, 0], [−P̂, 0]] with the momentum P = Σ m·u and L = −Σ m·r̂·û, whose sums over
    the links of a composite body are again such a pair.
    """
    matrix, links = ca.SX(robot.n, robot.n), _links(parameters)
    poses, xi = relative_poses(robot, motion), axes(robot)
    velocities = link_velocities(robot, motion)
    # rate of each axis: it moves with the links before it
    rates = [ca.mtimes(small_adjoint(v), axis) for v, axis in zip(velocities, xi, strict=True)]
    moments = [_point_moments(link, v) for link, v in zip(links, velocities, strict=True)]
    body, (momentum, turning) = links[-1], moments[-1]
    for j in reversed(range(robot.n)):
        inertia, axis = spatial_inertia(body), xi[j]
        bent = ca.vertcat(ca.mtimes(turning, axis[:3]), cross(axis[:3], momentum))
        own = ca.mtimes(inertia, rates[j]) + bent  # E·ξ̇ + B·ξ
        inert = ca.mtimes(inertia, axis)
        straight = ca.mtimes(turning.T, axis[:3]) + cross(momentum, axis[3:])
        back = ca.vertcat(straight, ca.SX(3, 1))  # Bᵀ·ξ
        for i in reversed(range(j + 1)):
            matrix[i, j] = ca.mtimes(xi[i].T, own)
            if i < j:
                matrix[j, i] = ca.mtimes(rates[i].T, inert) + ca.mtimes(xi[i].T, back)
            own, inert, back = (
                inverse_adjoint_transpose_times(poses[i], wrench) for wrench in (own, inert, back)
            )
        if j:
            g = poses[j]
            momentum = ca.mtimes(g.rotation, momentum)
            turning = ca.mtimes(g.rotation, ca.mtimes(turning, g.rotation.T))
            turning = moments[j - 1][1] + turning - ca.mtimes(hat(g.translation), hat(momentum))
            momentum = moments[j - 1][0] + momentum
            body = links[j - 1] + seen_from_parent(g, body)
    return matrix


def link_velocities(robot: Robot, motion: Motion) -> list[ca.SX]:
    """Return the twist V_i (6,) of each link in its own frame."""
    velocity, velocities = ca.SX(6, 1), []
    for i, (g, xi) in enumerate(zip(relative_poses(robot, motion), axes(robot), strict=True)):
        velocity = inverse_adjoint_times(g, velocity) + xi * motion.dq[i]
        velocities.append(velocity)
    return velocities


def _point_moments(link: ca.SX, velocity: ca.SX) -> tuple[ca.SX, ca.SX]:
    """Return Σ m·u (3,) and −Σ m·r̂·û (3, 3) of a link's points r, their velocity u = v + ω × r.

    With hat(ω × r) = ω̂r̂ − r̂ω̂ and r̂ω̂r̂ = −(r·ω)r̂ the sums are those of the inertia.
    """
    omega, v, moment, inertia = velocity[:3], velocity[3:], link[1:4], _inertia(link)
    second = 0.5 * ca.trace(inertia) * omega - ca.mtimes(inertia, omega)  # Σ m·r·rᵀ·ω
    turning = hat(second) - ca.mtimes(inertia, hat(omega)) - ca.mtimes(hat(moment), hat(v))
    return link[0] * v + cross(omega, moment), turning


def gravity(
    robot: Robot, motion: Motion, parameters: ca.SX, *, gravity: ca.SX | None = None
) -> ca.SX:
    """Return G(q) = ξᵀBᵀEBΓ_{V0}A₀ (n,): the torque at rest."""
    zero = ca.SX(robot.n, 1)
    still = Motion(motion.q, motion.sin, motion.cos, zero, zero)
    return inverse_dynamics(robot, still, parameters, gravity=gravity)


def jacobian(robot: Robot, motion: Motion) -> ca.SX:
    """Return the tool's Jacobian J (6, n): [ω; v] of the tool's origin in base axes = J·q̇.

    A wrench [m; f] that the tool exerts, in base axes at the tool's origin, adds Jᵀ·F (Eq. 1).
    """
    rotations = [pose.rotation for pose in link_poses(robot, motion)]
    steps = [pose.translation for pose in relative_poses(robot, motion)[1:]]
    arm, columns = ca.SX(3, 1), []  # from the joint's frame to the tool, in base axes
    for rotation, step, xi in zip(
        reversed(rotations),
        reversed([*steps, tool_pose(robot).translation]),
        reversed(axes(robot)),
        strict=True,
    ):
        arm = arm + ca.mtimes(rotation, step)
        angular = ca.mtimes(rotation, xi[:3])
        linear = ca.mtimes(rotation, xi[3:]) + cross(angular, arm)
        columns.append(ca.vertcat(angular, linear))
    return ca.horzcat(*reversed(columns))
