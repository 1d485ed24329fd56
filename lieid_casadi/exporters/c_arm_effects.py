"""Effects on the whole arm or on what is measured, at one instant: what exported C has of them."""

from __future__ import annotations

from dataclasses import dataclass, replace

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from lieid_casadi.dynamics import closed_form, recursion
from lieid_casadi.dynamics.base_parameters import parameter_transport
from lieid_casadi.dynamics.motion_symbols import Motion
from lieid_casadi.dynamics.regressor import regressor
from lieid_casadi.effects import ArmEffect
from lieid_casadi.errors import ExportError
from lieid_casadi.identification.fit import Fit
from lieid_casadi.model import Model
from lieid_casadi.robot.robot import Robot

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class OneInstant:
    """A model at one instant, as `ArmEffect.instant_columns` takes it.

    Attributes
    ----------
    links, all_links : (10 n,)
        Link parameters; the second set holds in any gravity.
    load, torque : (n,)
        Rigid torque, and with all effects on single joints.
    """

    robot: Robot
    motion: Motion
    links: ca.SX
    all_links: ca.SX
    load: ca.SX
    torque: ca.SX

    @property
    def gravity(self) -> Array:
        """Gravity (3,) in the base frame, m/s²."""
        return np.asarray(self.robot.gravity)

    def rigid_beside(self, offset: Array) -> ca.SX:
        """Return the rigid torque (n,) at q + offset (n,); sines by the addition theorem."""
        m, sin, cos = self.motion, np.sin(offset), np.cos(offset)
        moved = Motion(
            m.q + offset, m.sin * cos + m.cos * sin, m.cos * cos - m.sin * sin, m.dq, m.ddq
        )
        return recursion.inverse_dynamics(self.robot, moved, self.links)

    def gravity_torque(self, gravity: Array) -> ca.SX:
        """Return the torque (n,) at rest in another gravity (3,)."""
        robot = replace(self.robot, gravity=gravity)
        return closed_form.gravity(robot, self.motion, self.all_links)

    def jacobian(self) -> ca.SX:
        """Return the tool's Jacobian (6, n), [ω; v], base axes."""
        return closed_form.jacobian(self.robot, self.motion)

    def tool_regressor(self) -> ca.SX:
        """Return the rigid torque (n, 10) per link parameter of a body in the tool's frame."""
        last = regressor(self.robot, self.motion)[:, -10:]
        return ca.mtimes(last, ca.sparsify(ca.DM(parameter_transport(self.robot.tool))))


def with_arm_effects(columns: ca.SX, model: Model, arm: OneInstant, values: Array) -> ca.SX:
    """Return the effect columns (n, m) with those of effects on the whole arm filled in.

    Parameters
    ----------
    values : (m,)
        Coefficients of the fit: columns stand for the whole change that these make.

    Raises
    ------
    ExportError
        An effect needs more than one instant.
    """
    first = 0
    for p in model.placements:
        last = first + len(p.effect.coefficients)
        if isinstance(p.effect, ArmEffect):
            now = p.effect.instant_columns(arm, p.joint, values[first:last])
            if now is None:
                raise ExportError(
                    f"{p.label} needs the motion along time, of which exported C sees one "
                    "instant; expected a fit without it"
                )
            columns[:, first:last] = now
        first = last
    return columns


def arm_notes(fit: Fit) -> list[str]:
    """Return what a user of the code should know about such effects."""
    placed = [p for p in fit.model.placements if isinstance(p.effect, ArmEffect)]
    said = {p.label: p.effect.export_note for p in placed if isinstance(p.effect, ArmEffect)}
    notes = [f"{label}: {text}" for label, text in said.items() if text]
    inside = [label for label, text in said.items() if not text]
    if inside:
        notes.append(
            f"{', '.join(inside)}: counted among the effects; rigid_torque, gravity and "
            "mass_matrix are those of the arm without"
        )
    return notes
