"""Dynamics of a fitted model for export: expressions with the identified numbers as constants."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import casadi as ca
import numpy as np

from lieid_casadi.arrays import Array
from lieid_casadi.dynamics import closed_form, recursion
from lieid_casadi.dynamics.base_parameters import base_parameters
from lieid_casadi.dynamics.lie import Motion
from lieid_casadi.dynamics.regressor import regressor, slotine_li_regressor
from lieid_casadi.effects import ArmEffect
from lieid_casadi.effects.effect import EffectSignals
from lieid_casadi.errors import ExportError
from lieid_casadi.expressions import forward_dynamics
from lieid_casadi.expressions.frames import homogeneous
from lieid_casadi.expressions.torque import TorqueExpressions, Values
from lieid_casadi.identification.fit import Fit

AGREEMENT = 1e-13  # of the torque with fewer parameters, relative; the self-test requires 1e-12


@dataclass(frozen=True, eq=False)
class SampleSymbols:
    """Symbols of the sample before, on which states depend; (n,) unless stated."""

    motion: Motion
    sign: ca.SX
    load: ca.SX
    temperature: ca.SX
    time: ca.SX

    @classmethod
    def before(cls, n: int) -> SampleSymbols:
        """Return new symbols."""
        sign, load, temperature = (ca.SX.sym(f"before_{x}", n) for x in ("sign", "load", "temp"))
        return cls(Motion.symbols(n), sign, load, temperature, ca.SX.sym("before_time"))


class ExportExpressions(TorqueExpressions):
    """The torque of a model and its parts, and what controllers need besides."""

    def __init__(self, fit: Fit, values: Values, *, payload: bool = False) -> None:
        n = fit.model.n
        self.sign, self.dq_r, self.ddq_r = (ca.SX.sym(x, n) for x in ("sign", "dq_r", "ddq_r"))
        super().__init__(
            fit.model, values, None, as_measured=False, payload=payload, sign=self.sign,
            motion=Motion.symbols(n),
        )  # fmt: skip

    @cached_property
    def forward_kinematics(self) -> ca.SX:
        """Pose (4, 4) of the tool in the base frame."""
        return homogeneous(recursion.tool_in_base(self.model.robot, self.motion))

    @cached_property
    def jacobian(self) -> ca.SX:
        """J (6, n) of the tool: [ω; v] in axes of the base."""
        return closed_form.jacobian(self.model.robot, self.motion)

    @cached_property
    def regressor(self) -> ca.SX:
        """Y (n, 10 n)."""
        return regressor(self.model.robot, self.motion)

    @cached_property
    def slotine_li_regressor(self) -> ca.SX:
        """Y(q, q̇, q̇_r, q̈_r) (n, 10 n)."""
        reference = recursion.ReferenceMotion(self.dq_r, self.ddq_r)
        return slotine_li_regressor(self.model.robot, self.motion, reference)

    @cached_property
    def effect_columns(self) -> ca.SX:
        """Columns (n, m) of all effects, those on the measurement included."""
        columns = ca.SX(self.joint_columns)
        for slot in self.model.slots:
            p, own = slot.placement, slot.columns
            if isinstance(p.effect, ArmEffect):
                now = p.effect.instant_columns(self._instant, p.joint, self.values.effects[own])
                if now is None:
                    raise ExportError(
                        f"{p.label} needs the motion over time, and exported C has one instant; "
                        "expected a fit without this effect"
                    )
                columns[:, own] = now
        return columns

    @cached_property
    def base_regressor(self) -> ca.SX:
        """Y_b (n, p), effects included."""
        kept = [int(k) for k in self.model.base.kept]
        return ca.horzcat(self.regressor, self.effect_columns)[:, kept]

    @cached_property
    def effect_torque(self) -> ca.SX:
        """Torque of all effects (n,)."""
        return ca.mtimes(self.effect_columns, self.values.effects)

    @cached_property
    def torque(self) -> ca.SX:
        """Rigid torque and effects (n,), the load being that rigid torque."""
        load = ca.densify(self.rigid_torque)
        return self.rigid_torque + ca.substitute(self.effect_torque, self.load, load)

    @cached_property
    def forward_dynamics(self) -> ca.SX:
        """q̈ (n,) for the torque that the drives deliver."""
        return forward_dynamics.acceleration(self)

    def advance(self, before: SampleSymbols) -> ca.SX:
        """Return the states (S,) at this sample from those at the sample before."""
        m = before.motion
        past = EffectSignals(
            m.q, m.dq, m.ddq, before.sign, before.load, before.temperature, before.time
        )
        return self.model.advance(past, self._signals, self.values.shapes, self.states)


def export_expressions(fit: Fit, *, payload: bool = False) -> ExportExpressions:
    """Return expressions of the identified numbers; ``payload``: with a body as input."""
    # in another direction of gravity than the robot's, more link parameters have an effect
    whole = any(isinstance(p.effect, ArmEffect) for p in fit.model.placements)
    links = fit.link_parameters if whole else fewer_parameters(fit)
    numbers = Values.numbers(links, fit.effect_coefficients, fit.shapes)
    return ExportExpressions(fit, numbers, payload=payload)


def fewer_parameters(fit: Fit) -> Array:
    """Return link parameters (10 n,) with the same torque and as many zeros as possible.

    Only the parameters that head a rigid base parameter are not zero. If rounding in the geometry
    of the robot would change the torque, the link parameters of the fit are returned.
    """
    robot, links = fit.model.robot, fit.link_parameters
    base = base_parameters(robot)
    fewer = np.zeros_like(links)
    fewer[base.kept] = base.combination @ links
    motion = Motion.symbols(robot.n)
    symbols = [motion.q, motion.sin, motion.cos, motion.dq, motion.ddq]
    y = ca.Function("y", symbols, [ca.densify(regressor(robot, motion))])
    random = np.random.default_rng(0)
    for _ in range(20):
        q, dq, ddq = random.uniform(-3.0, 3.0, (3, robot.n))
        matrix = np.array(y(q, np.sin(q), np.cos(q), dq, ddq))
        size = np.abs(matrix @ links).max()
        if np.abs(matrix @ (links - fewer)).max() > AGREEMENT * size:
            return links
    return fewer
