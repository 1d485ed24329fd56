"""Newton-Euler recursion on twists and wrenches (Luo et al. 2024, Eqs. 2-3, slips mended)."""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca

from lieid_casadi.dynamics.lie import (
    Pose,
    constant,
    cross,
    hat,
    inverse_adjoint_times,
    inverse_adjoint_transpose_times,
)
from lieid_casadi.dynamics.motion import Motion, axes, relative_poses, tool_pose
from lieid_casadi.robot.robot import Robot


@dataclass(frozen=True)
class BodyMotion:
    """Motion of one link frame, expressed in it.

    ``velocity`` is the twist V (6,); ``angular_acceleration`` (3,) and ``acceleration`` (3,)
    are those of the frame's origin against free fall (gravity included, A₀ = [0; −g]).
    """

    velocity: ca.SX
    angular_acceleration: ca.SX
    acceleration: ca.SX


def body_motions(robot: Robot, motion: Motion) -> list[BodyMotion]:
    """Forward recursion, Eq. 2: V_i = Ad⁻¹V_{i−1} + ξq̇, A_i = Ad⁻¹A_{i−1} + ad_{Ad⁻¹V}(ξq̇) + ξq̈."""
    velocity, acceleration = ca.SX(6, 1), ca.vertcat(ca.SX(3, 1), constant(-robot.gravity))
    motions = []
    for i, (g, xi) in enumerate(zip(relative_poses(robot, motion), axes(robot), strict=True)):
        carried = inverse_adjoint_times(g, velocity)
        rate = xi * motion.dq[i]
        velocity = carried + rate
        bracket = ca.vertcat(
            cross(carried[:3], rate[:3]),
            cross(carried[3:], rate[:3]) + cross(carried[:3], rate[3:]),
        )
        acceleration = inverse_adjoint_times(g, acceleration) + bracket + xi * motion.ddq[i]
        omega, v = velocity[:3], velocity[3:]
        # the spatial acceleration lacks ω × v to be that of the point at the origin
        motions.append(
            BodyMotion(velocity, acceleration[:3], acceleration[3:] + cross(omega, v))
        )
    return motions


def body_wrench(link: ca.SX, body: BodyMotion) -> ca.SX:
    """Return E·A − ad_Vᵀ·(E·V) (6,), the wrench that moves a link with parameters (10,)."""
    omega, alpha, a = body.velocity[:3], body.angular_acceleration, body.acceleration
    mass, moment = link[0], link[1:4]
    inertia = ca.vertcat(
        ca.horzcat(link[4], link[5], link[7]),
        ca.horzcat(link[5], link[6], link[8]),
        ca.horzcat(link[7], link[8], link[9]),
    )
    turning = hat(alpha) + ca.mtimes(hat(omega), hat(omega))
    return ca.vertcat(
        ca.mtimes(inertia, alpha) + cross(omega, ca.mtimes(inertia, omega)) + cross(moment, a),
        mass * a + ca.mtimes(turning, moment),
    )


def inverse_dynamics(
    robot: Robot, motion: Motion, parameters: ca.SX, *, tool_wrench: ca.SX | None = None
) -> ca.SX:
    """Return the rigid torque (n,) by the backward recursion, Eq. 3.

    Parameters
    ----------
    parameters : (10 n,)
        Link parameters.
    tool_wrench : (6,), optional
        [m; f] that the tool exerts on its surroundings, at the tool's origin, in tool axes.
    """
    poses, xi = relative_poses(robot, motion), axes(robot)
    wrench = ca.SX(6, 1)
    if tool_wrench is not None:
        wrench = inverse_adjoint_transpose_times(tool_pose(robot), tool_wrench)
    torque = [ca.SX(1, 1)] * robot.n
    bodies = body_motions(robot, motion)
    for i in reversed(range(robot.n)):
        wrench = wrench + body_wrench(parameters[10 * i : 10 * i + 10], bodies[i])
        torque[i] = ca.mtimes(xi[i].T, wrench)
        wrench = inverse_adjoint_transpose_times(poses[i], wrench)
    return ca.vertcat(*torque)


def tool_in_base(robot: Robot, motion: Motion) -> Pose:
    """Return the tool's pose in the base frame."""
    here = pose_of_last_link(robot, motion)
    return here @ tool_pose(robot)


def pose_of_last_link(robot: Robot, motion: Motion) -> Pose:
    """Return the last link frame in the base frame."""
    poses = relative_poses(robot, motion)
    here = poses[0]
    for g in poses[1:]:
        here = here @ g
    return here
