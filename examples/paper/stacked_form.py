"""Closed form of the dynamics with stacked matrices, as printed (Luo et al. 2024, Eqs. 4-5).

All links are stacked into one equation: V = Γ·V + ξ·q̇ gives V = B·ξ·q̇ with B = (I − Γ)⁻¹, and

    τ_d = ξᵀBᵀEBξ·q̈ − ξᵀBᵀ(EBΛ_{ξq̇}Γ + Λ_V E)Bξ·q̇ + ξᵀBᵀEBΓ_{V0}·A₀ + ξᵀBᵀΓ_{F0}ᵀ·F_ext.

Eqs. 4-5 hold as printed if the matrices, which the paper takes from its reference 6, are defined as
in `StackedMatrices`. Around them the print contains errors:

- Eq. 2: the sign before ad must be + for ad_{Ad⁻¹V_{i−1}}(ξ_i q̇_i), which equals
  −ad_{ξ_i q̇_i}(Ad⁻¹V_{i−1}); Λ_{ξq̇} below is the latter, hence the minus of the second term.
- Eq. 3: the wrench of the next link needs the inverse, (Ad⁻¹_{g_{i,i+1}})ᵀ·F_{i+1}; Γᵀ contains it.
- E: the bottom right block is m·1₃, although its symbol is that of an inertia.
- J = Γ_{F0}Bξ is the Jacobian in the axes of the tool, and F_ext is in these axes, too.

These matrices have (6n)² entries, mostly zero. `lieid_casadi.dynamics.closed_form` and
`lieid_casadi.dynamics.recursion` compute the same results without them.
"""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca
import numpy as np

from lieid_casadi.dynamics.closed_form import spatial_inertia
from lieid_casadi.dynamics.lie import (
    Motion,
    axes,
    constant,
    inverse_adjoint_times,
    relative_poses,
    small_adjoint,
    tool_pose,
)
from lieid_casadi.robot.robot import Robot


@dataclass(frozen=True, eq=False)
class StackedMatrices:
    """The matrices of Eqs. 4-5; twists [ω; v] and wrenches [m; f] in link frames.

    Attributes
    ----------
    transport : (6n, 6n)
        Γ, with Ad⁻¹ of g_{i−1,i} in block (i, i − 1).
    propagation : (6n, 6n)
        B = (I − Γ)⁻¹, with Ad⁻¹ of g_{j,i} in block (i, j), j ≤ i.
    axes : (6n, n)
        ξ, with the unit twist ξ_i in block (i, i).
    inertia : (6n, 6n)
        E, block diagonal.
    joint_rates : (6n, 6n)
        Λ_{ξq̇}, block diagonal, ad of ξ_i·q̇_i.
    link_velocities : (6n, 6n)
        Λ_V, block diagonal, adᵀ of V_i.
    base : (6n, 6)
        Γ_{V0}, with Ad⁻¹ of g_{0,1} in its first block.
    tool : (6, 6n)
        Γ_{F0}, with Ad⁻¹ of the tool's pose in its last block.
    base_acceleration : (6,)
        A₀ = [0; −g], m/s².
    """

    transport: ca.SX
    propagation: ca.SX
    axes: ca.SX
    inertia: ca.SX
    joint_rates: ca.SX
    link_velocities: ca.SX
    base: ca.SX
    tool: ca.SX
    base_acceleration: ca.SX

    @property
    def mass_matrix(self) -> ca.SX:
        """M(q) = ξᵀBᵀEBξ (n, n)."""
        return self._projected(ca.mtimes([self.inertia, self.propagation, self.axes]))

    @property
    def velocity_matrix(self) -> ca.SX:
        """V(q, q̇) = −ξᵀBᵀ(EBΛ_{ξq̇}Γ + Λ_V E)Bξ (n, n).

        V·q̇ is the Coriolis and centripetal torque, but Ṁ − 2V is not skew-symmetric: passivity
        needs `lieid_casadi.dynamics.closed_form.coriolis_matrix`.
        """
        carried = ca.mtimes([self.inertia, self.propagation, self.joint_rates, self.transport])
        inner = carried + ca.mtimes(self.link_velocities, self.inertia)
        return -self._projected(ca.mtimes([inner, self.propagation, self.axes]))

    @property
    def gravity(self) -> ca.SX:
        """G(q) = ξᵀBᵀEBΓ_{V0}A₀ (n,), N·m."""
        return self._projected(
            ca.mtimes([self.inertia, self.propagation, self.base, self.base_acceleration])
        )

    @property
    def jacobian(self) -> ca.SX:
        """J(q) = Γ_{F0}Bξ (6, n), in the axes of the tool."""
        return ca.mtimes([self.tool, self.propagation, self.axes])

    def _projected(self, wrenches: ca.SX) -> ca.SX:
        """Return ξᵀBᵀ times wrenches (6n, k) of the links."""
        return ca.mtimes([self.axes.T, self.propagation.T, wrenches])


def stacked_matrices(robot: Robot, motion: Motion, parameters: ca.SX) -> StackedMatrices:
    """Return the matrices of Eqs. 4-5 at a motion.

    ``robot``: its geometry and gravity; ``motion``: q, q̇ (n,); ``parameters`` (10 n,): link
    parameters.
    """
    n, poses, xi = robot.n, relative_poses(robot, motion), axes(robot)
    unit = ca.SX(ca.DM.eye(6))
    back = [inverse_adjoint_times(g, unit) for g in poses]
    transport, propagation = ca.SX(6 * n, 6 * n), ca.SX(ca.sparsify(ca.DM.eye(6 * n)))
    for i in range(1, n):
        rows, before = slice(6 * i, 6 * i + 6), slice(6 * i - 6, 6 * i)
        transport[rows, before] = back[i]
        propagation[rows, : 6 * i] = ca.mtimes(back[i], propagation[before, : 6 * i])
    twists = ca.diagcat(*xi)
    velocity = ca.mtimes([propagation, twists, motion.dq])
    links = [parameters[k : k + 10] for k in range(0, 10 * n, 10)]
    return StackedMatrices(
        transport=transport,
        propagation=propagation,
        axes=twists,
        inertia=ca.diagcat(*(spatial_inertia(link) for link in links)),
        joint_rates=ca.diagcat(*(small_adjoint(xi[i] * motion.dq[i]) for i in range(n))),
        link_velocities=ca.diagcat(
            *(small_adjoint(velocity[6 * i : 6 * i + 6]).T for i in range(n))
        ),
        base=ca.vertcat(back[0], ca.SX(6 * (n - 1), 6)),
        tool=ca.horzcat(ca.SX(6, 6 * (n - 1)), inverse_adjoint_times(tool_pose(robot), unit)),
        base_acceleration=constant(np.concatenate([np.zeros(3), -robot.gravity])),
    )
