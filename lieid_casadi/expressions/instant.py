"""A model at one instant in symbols, as effects on the whole arm or on the measurement use it."""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca

from lieid_casadi.dynamics import closed_form, recursion
from lieid_casadi.dynamics.lie import constant
from lieid_casadi.dynamics.motion_symbols import Motion, tool_pose
from lieid_casadi.dynamics.regressor import regressor
from lieid_casadi.effects import ArmEffect
from lieid_casadi.errors import ModelError
from lieid_casadi.model import Model
from lieid_casadi.robot.robot import Robot


@dataclass(frozen=True, eq=False)
class ArmInstant:
    """A model at one instant; implements `lieid_casadi.effects.arm_effect.InstantModel`.

    Attributes
    ----------
    robot : Robot
    motion : Motion
        Symbols q, q̇, q̈ (n,).
    links, all_links : (10 n,)
        Link parameters; the second set holds in any gravity.
    load, torque : (n,)
        Rigid torque, and rigid torque with all effects on single joints, N·m.
    """

    robot: Robot
    motion: Motion
    links: ca.SX
    all_links: ca.SX
    load: ca.SX
    torque: ca.SX

    @property
    def gravity(self) -> ca.SX:
        """Gravity (3,) in the base frame, m/s²."""
        return ca.densify(constant(self.robot.gravity))

    def rigid_beside(self, offset: ca.SX) -> ca.SX:
        """Return the rigid torque (n,) at q + offset (n,), by the addition theorem."""
        m, sin, cos = self.motion, ca.sin(offset), ca.cos(offset)
        moved = Motion(
            m.q + offset, m.sin * cos + m.cos * sin, m.cos * cos - m.sin * sin, m.dq, m.ddq
        )
        return recursion.inverse_dynamics(self.robot, moved, self.links)

    def gravity_torque(self, gravity: ca.SX) -> ca.SX:
        """Return the torque (n,) at rest in another gravity (3,), m/s²."""
        return closed_form.gravity(self.robot, self.motion, self.all_links, gravity=gravity)

    def jacobian(self) -> ca.SX:
        """Return the tool's Jacobian (6, n), [ω; v], base axes."""
        return closed_form.jacobian(self.robot, self.motion)

    def tool_regressor(self) -> ca.SX:
        """Return the rigid torque (n, 10) per link parameter of a body in the tool frame."""
        body = ca.SX.sym("body", 10)
        at_link = closed_form.seen_from_parent(tool_pose(self.robot), body)
        last = regressor(self.robot, self.motion)[:, -10:]
        return ca.mtimes(last, ca.jacobian(at_link, body))


def arm_effect_columns(
    model: Model, arm: ArmInstant, coefficients: ca.SX, *, measurement: bool
) -> ca.SX:
    """Return the columns (n, m) of effects on the whole arm or on the measurement; others are zero.

    ``coefficients`` (m,): linear coefficients, numbers or symbols; ``measurement``: whether the
    columns are those of effects on the measurement, else on the whole arm.
    Raises `ModelError`: an effect on the measurement depends on the motion before the instant.
    """
    columns = ca.SX(model.n, len(model.columns))
    first = 0
    for p in model.placements:
        last = first + len(p.effect.coefficients)
        if isinstance(p.effect, ArmEffect) and p.effect.on_measurement == measurement:
            if p.effect.needs_past:
                raise ModelError(
                    f"{p.label}: the measured torque depends on the motion before the instant; "
                    "expected a model without this effect, or as_measured=False"
                )
            now = p.effect.instant_columns(arm, p.joint, coefficients[first:last])
            if now is not None:
                columns[:, first:last] = now
        first = last
    return columns
