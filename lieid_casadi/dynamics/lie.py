"""Lie operators of SE(3) as sparse CasADi expressions, and the poses of a moving arm.

Twists are [ω; v], wrenches [m; f]. Constants that are zero up to rounding become structural
zeros, so that products of mostly zeros cost nothing.
"""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from lieid_casadi.arrays import Array
from lieid_casadi.robot.inertia import relative
from lieid_casadi.robot.robot import Robot

ROUNDING = 1e-14  # below it a geometric constant is exactly 0 (or ±1)


def constant(values: ArrayLike) -> ca.SX:
    """Return geometry as SX, with rounding errors of numbers around 0 and ±1 removed."""
    array = np.array(values, dtype=float)
    for exact in (-1.0, 0.0, 1.0):
        array[np.abs(array - exact) < ROUNDING] = exact
    return ca.SX(ca.sparsify(ca.DM(array)))


def hat(w: ca.SX) -> ca.SX:
    """Return the skew matrix (3, 3) of a vector (3,): hat(w)·x = w × x."""
    return ca.sparsify(ca.skew(w))


def cross(a: ca.SX, b: ca.SX) -> ca.SX:
    """Return a × b for vectors (3,)."""
    return ca.mtimes(hat(a), b)


@dataclass(frozen=True)
class Pose:
    """An element of SE(3): rotation (3, 3) and translation (3,)."""

    rotation: ca.SX
    translation: ca.SX

    def __matmul__(self, other: Pose) -> Pose:
        return Pose(
            ca.mtimes(self.rotation, other.rotation),
            ca.mtimes(self.rotation, other.translation) + self.translation,
        )


def pose(matrix: ArrayLike) -> Pose:
    """Return a constant pose from its homogeneous matrix (4, 4)."""
    m = np.asarray(matrix)
    return Pose(constant(m[:3, :3]), constant(m[:3, 3]))


def exp(screw: Array, q: ca.SX, sin: ca.SX, cos: ca.SX) -> Pose:
    """Return exp(ξ̂·q) for a screw [ω; v] of zero pitch, |ω| = 1, or ω = 0 and |v| = 1.

    ``sin`` and ``cos`` are those of q, so that generated code can take them as inputs.
    """
    omega, v = screw[:3], screw[3:]
    if constant(omega).nnz() == 0:
        return Pose(ca.SX(ca.DM.eye(3)), constant(v) * q)
    along = np.outer(omega, omega)
    rotation = constant(along) + cos * constant(np.eye(3) - along) + sin * hat(constant(omega))
    # (I − R)(ω × v); the pitch term ωωᵀv·q vanishes
    moment = np.cross(omega, v)
    across, turned = constant(moment), constant(np.cross(omega, moment))
    return Pose(rotation, across * (1 - cos) - turned * sin)


def small_adjoint(twist: ca.SX) -> ca.SX:
    """Return ad_V (6, 6) = [[ω̂, 0], [v̂, ω̂]]."""
    omega, v = hat(twist[:3]), hat(twist[3:])
    return ca.vertcat(ca.horzcat(omega, ca.SX(3, 3)), ca.horzcat(v, omega))


def inverse_adjoint_times(g: Pose, twist: ca.SX) -> ca.SX:
    """Return Ad_g⁻¹·V for a twist (6,) or several as columns (6, k)."""
    omega, v = twist[:3, :], twist[3:, :]
    back = g.rotation.T
    return ca.vertcat(
        ca.mtimes(back, omega), ca.mtimes(back, v - ca.mtimes(hat(g.translation), omega))
    )


def inverse_adjoint_transpose_times(g: Pose, wrench: ca.SX) -> ca.SX:
    """Return (Ad_g⁻¹)ᵀ·F: a wrench (6,) of the child frame, expressed in the parent frame."""
    moment = ca.mtimes(g.rotation, wrench[:3])
    force = ca.mtimes(g.rotation, wrench[3:])
    return ca.vertcat(moment + cross(g.translation, force), force)


@dataclass(frozen=True)
class Motion:
    """Symbols q, q̇, q̈ (n,) with the sines and cosines of q.

    Sines and cosines are separate symbols because generated code computes them for many samples at
    once. `of` substitutes ``ca.sin(q)`` and ``ca.cos(q)``.
    """

    q: ca.SX
    sin: ca.SX
    cos: ca.SX
    dq: ca.SX
    ddq: ca.SX

    @classmethod
    def symbols(cls, n: int) -> Motion:
        """Return fresh symbols, sines and cosines being symbols too."""
        return cls(*(ca.SX.sym(name, n) for name in ("q", "sin", "cos", "dq", "ddq")))

    @classmethod
    def of(cls, q: ca.SX, dq: ca.SX | None = None, ddq: ca.SX | None = None) -> Motion:
        """Return the motion of expressions (n,); rates that are left out are structurally zero."""
        zero = ca.SX(q.shape[0], 1)
        dq, ddq = (zero if rate is None else rate for rate in (dq, ddq))
        return cls(q, ca.sin(q), ca.cos(q), dq, ddq)


def relative_poses(robot: Robot, motion: Motion) -> list[Pose]:
    """Return g_{i-1,i}(q): each link frame in the frame of the link before (base first)."""
    poses, before = [], np.eye(4)
    for i, joint in enumerate(robot.joints):
        home = pose(relative(before, joint.home))
        poses.append(home @ exp(joint.axis, motion.q[i], motion.sin[i], motion.cos[i]))
        before = joint.home
    return poses


def axes(robot: Robot) -> list[ca.SX]:
    """Return each joint's unit twist ξ_i (6,) in its link frame."""
    return [constant(joint.axis) for joint in robot.joints]


def tool_pose(robot: Robot) -> Pose:
    """Return the tool in the last link's frame."""
    return pose(robot.tool)
