"""Closed form of the dynamics: M, V, C, G and J as expressions (Eqs. 4-5).

The stacked matrices of the paper are block lower bidiagonal; their products are evaluated
block by block, which is the same algebra without the zeros:
B·ξ is the stack of the link Jacobians J_i = Ad⁻¹J_{i−1} + ξ_i·e_iᵀ.
"""

from __future__ import annotations

import casadi as ca

from lieid_casadi.dynamics.lie import hat, inverse_adjoint_times, small_adjoint
from lieid_casadi.dynamics.motion import Motion, axes, relative_poses, tool_pose
from lieid_casadi.dynamics.recursion import inverse_dynamics, tool_in_base
from lieid_casadi.robot.robot import Robot


def spatial_inertia(link: ca.SX) -> ca.SX:
    """Return E (6, 6) = [[I, m·ĉ], [−m·ĉ, m·1₃]] at the link frame's origin."""
    moment = hat(link[1:4])
    inertia = ca.vertcat(
        ca.horzcat(link[4], link[5], link[7]),
        ca.horzcat(link[5], link[6], link[8]),
        ca.horzcat(link[7], link[8], link[9]),
    )
    mass = link[0] * ca.SX(ca.DM.eye(3))
    return ca.vertcat(ca.horzcat(inertia, moment), ca.horzcat(-moment, mass))


def link_jacobians(robot: Robot, motion: Motion) -> list[ca.SX]:
    """Return J_i (6, n) of each link, in its own frame: V_i = J_i·q̇ (the blocks of B·ξ)."""
    jacobian, jacobians = ca.SX(6, robot.n), []
    for i, (g, xi) in enumerate(zip(relative_poses(robot, motion), axes(robot), strict=True)):
        jacobian = inverse_adjoint_times(g, jacobian)
        jacobian[:, i] = xi
        jacobians.append(jacobian)
    return jacobians


def _links(parameters: ca.SX) -> list[ca.SX]:
    return [parameters[k : k + 10] for k in range(0, parameters.shape[0], 10)]


def mass_matrix(robot: Robot, motion: Motion, parameters: ca.SX) -> ca.SX:
    """Return M(q) = ξᵀBᵀEBξ (n, n)."""
    matrix = ca.SX(robot.n, robot.n)
    for jacobian, link in zip(link_jacobians(robot, motion), _links(parameters), strict=True):
        matrix = matrix + ca.mtimes(jacobian.T, ca.mtimes(spatial_inertia(link), jacobian))
    return matrix


def velocity_matrix(robot: Robot, motion: Motion, parameters: ca.SX) -> ca.SX:
    """Return V(q, q̇) = −ξᵀBᵀ(EBΛ_{ξq̇}Γ + Λ_V E)Bξ (n, n) of Eq. 5.

    V·q̇ is the Coriolis and centripetal torque, but Ṁ − 2V is not skew-symmetric; use
    `coriolis_matrix` where passivity matters.
    """
    matrix = ca.SX(robot.n, robot.n)
    jacobians, poses = link_jacobians(robot, motion), relative_poses(robot, motion)
    before, carried = ca.SX(6, robot.n), ca.SX(6, robot.n)
    for i, (link, xi) in enumerate(zip(_links(parameters), axes(robot), strict=True)):
        inertia, jacobian = spatial_inertia(link), jacobians[i]
        turned = ca.mtimes(
            small_adjoint(xi * motion.dq[i]), inverse_adjoint_times(poses[i], before)
        )
        carried = inverse_adjoint_times(poses[i], carried) + turned
        momentum_rate = small_adjoint(ca.mtimes(jacobian, motion.dq)).T
        inner = ca.mtimes(inertia, carried) + ca.mtimes(momentum_rate, ca.mtimes(inertia, jacobian))
        matrix = matrix - ca.mtimes(jacobian.T, inner)
        before = jacobian
    return matrix


def coriolis_matrix(robot: Robot, motion: Motion, parameters: ca.SX) -> ca.SX:
    """Return C(q, q̇) (n, n) with C·q̇ = V·q̇ and Ṁ − 2C skew-symmetric.

    C = Σ Jᵀ(E·J̇ + B·J) with a skew B(E, V), in body frames; Echeandia & Wensing, "Numerical
    methods to compute the Coriolis matrix and Christoffel symbols for rigid-body systems",
    J. Comput. Nonlinear Dynam. 2021.
    """
    matrix = ca.SX(robot.n, robot.n)
    jacobians, poses = link_jacobians(robot, motion), relative_poses(robot, motion)
    before, rate = ca.SX(6, robot.n), ca.SX(6, robot.n)
    for i, (link, xi) in enumerate(zip(_links(parameters), axes(robot), strict=True)):
        inertia, jacobian = spatial_inertia(link), jacobians[i]
        carried = inverse_adjoint_times(poses[i], before)
        rate = inverse_adjoint_times(poses[i], rate) - ca.mtimes(
            small_adjoint(xi * motion.dq[i]), carried
        )
        twist = ca.mtimes(jacobian, motion.dq)
        inner = ca.mtimes(inertia, rate) + ca.mtimes(_body_coriolis(inertia, twist), jacobian)
        matrix = matrix + ca.mtimes(jacobian.T, inner)
        before = jacobian
    return matrix


def _body_coriolis(inertia: ca.SX, twist: ca.SX) -> ca.SX:
    """Return B (6, 6), skew, with B·V = −ad_Vᵀ·E·V."""
    ad = small_adjoint(twist)
    momentum = ca.mtimes(inertia, twist)
    moment, force = hat(momentum[:3]), hat(momentum[3:])
    swapped = ca.vertcat(ca.horzcat(-moment, -force), ca.horzcat(-force, ca.SX(3, 3)))
    return 0.5 * (-ca.mtimes(ad.T, inertia) + ca.mtimes(inertia, ad) + swapped)


def gravity(robot: Robot, motion: Motion, parameters: ca.SX) -> ca.SX:
    """Return G(q) = ξᵀBᵀEBΓ_{V0}A₀ (n,): the torque at rest."""
    zero = ca.SX(robot.n, 1)
    still = Motion(motion.q, motion.sin, motion.cos, zero, zero)
    return inverse_dynamics(robot, still, parameters)


def jacobian(robot: Robot, motion: Motion) -> ca.SX:
    """Return the tool's Jacobian J (6, n): [ω; v] of the tool's origin in base axes = J·q̇.

    A wrench [m; f] that the tool exerts, in base axes at the tool's origin, adds Jᵀ·F to the
    torque (Eq. 1).
    """
    in_tool = inverse_adjoint_times(tool_pose(robot), link_jacobians(robot, motion)[-1])
    rotation = tool_in_base(robot, motion).rotation
    return ca.vertcat(ca.mtimes(rotation, in_tool[:3, :]), ca.mtimes(rotation, in_tool[3:, :]))
