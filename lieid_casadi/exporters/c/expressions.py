"""Dynamics of a fitted model for export: expressions with the identified numbers as constants."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass
from functools import cached_property

import casadi as ca
import numpy as np

from lieid_casadi.arrays import Array
from lieid_casadi.dynamics import closed_form, recursion
from lieid_casadi.dynamics.base_parameters import BaseParameters, base_parameters
from lieid_casadi.dynamics.lie import Motion
from lieid_casadi.dynamics.regressor import regressor, slotine_li_regressor
from lieid_casadi.effects import ArmEffect
from lieid_casadi.effects.signals import EffectSignals
from lieid_casadi.exporters.c.arm_effects import with_arm_effects
from lieid_casadi.expressions import forward_dynamics
from lieid_casadi.expressions.frames import homogeneous
from lieid_casadi.expressions.torque import ArmInstant, TorqueExpressions, Values, with_body
from lieid_casadi.identification.fit import Fit

AGREEMENT = 1e-13  # of the torque with fewer parameters, relative; the self-test requires 1e-12


@dataclass(frozen=True, eq=False)
class ExportSymbols:
    """Symbols on which exported functions depend, (n,) unless stated."""

    motion: Motion
    dq_r: ca.SX
    ddq_r: ca.SX
    sign: ca.SX
    load: ca.SX
    torque: ca.SX
    temperature: ca.SX
    time: ca.SX
    states: ca.SX

    @classmethod
    def of(cls, fit: Fit, prefix: str = "") -> ExportSymbols:
        """Return new symbols; those of an earlier sample have a ``prefix``."""
        n = fit.model.n

        def column(name: str, size: int = n) -> ca.SX:
            return ca.SX.sym(prefix + name, size)

        return cls(
            motion=Motion(*(column(name) for name in ("q", "sin", "cos", "dq", "ddq"))),
            dq_r=column("dq_r"),
            ddq_r=column("ddq_r"),
            sign=column("sign"),
            load=column("load"),
            torque=column("torque"),
            temperature=column("temperature"),
            time=column("time", 1),
            states=column("states", len(fit.model.states)),
        )

    @property
    def signals(self) -> EffectSignals:
        """The signals of effects."""
        m = self.motion
        return EffectSignals(m.q, m.dq, m.ddq, self.sign, self.load, self.temperature, self.time)


@dataclass(frozen=True, eq=False)
class ModelNumbers:
    """Numbers of a model: constants, or symbols where they are inputs of the C functions.

    ``links`` (10 n,) may be a reduced set with the torque of ``all_links``; both contain the
    payload. ``inputs`` are the symbols by the names of their C arrays.
    """

    links: ca.SX
    all_links: ca.SX
    coefficients: ca.SX
    shapes: ca.SX
    inputs: dict[str, ca.SX]


class ExportExpressions:
    """Functions of a model for given link parameters, coefficients and shape parameters.

    ``symbols``: symbols of the sample; ``numbers``: in another direction of gravity than the
    robot's, more link parameters have an effect than its reduced set has.
    """

    def __init__(self, fit: Fit, symbols: ExportSymbols, numbers: ModelNumbers) -> None:
        self._model, self._symbols = fit.model, symbols
        self._links, self._all_links = numbers.links, numbers.all_links
        self._coefficients, self._shapes = numbers.coefficients, numbers.shapes

    @cached_property
    def rigid_torque(self) -> ca.SX:
        """Rigid torque (n,)."""
        symbols = self._symbols
        return recursion.inverse_dynamics(self._model.robot, symbols.motion, self._links)

    @cached_property
    def gravity(self) -> ca.SX:
        """G (n,)."""
        return closed_form.gravity(self._model.robot, self._symbols.motion, self._links)

    @cached_property
    def mass_matrix(self) -> ca.SX:
        """M (n, n)."""
        return closed_form.mass_matrix(self._model.robot, self._symbols.motion, self._links)

    @cached_property
    def coriolis(self) -> ca.SX:
        """C (n, n) with Ṁ − 2C skew-symmetric."""
        return closed_form.coriolis_matrix(self._model.robot, self._symbols.motion, self._links)

    @cached_property
    def forward_kinematics(self) -> ca.SX:
        """Pose (4, 4) of the tool in the base frame."""
        return homogeneous(recursion.tool_in_base(self._model.robot, self._symbols.motion))

    @cached_property
    def jacobian(self) -> ca.SX:
        """J (6, n) of the tool: [ω; v] in axes of the base."""
        return closed_form.jacobian(self._model.robot, self._symbols.motion)

    @cached_property
    def regressor(self) -> ca.SX:
        """Y (n, 10 n)."""
        return regressor(self._model.robot, self._symbols.motion)

    @cached_property
    def slotine_li_regressor(self) -> ca.SX:
        """Y(q, q̇, q̇_r, q̈_r) (n, 10 n)."""
        s = self._symbols
        reference = recursion.ReferenceMotion(s.dq_r, s.ddq_r)
        return slotine_li_regressor(self._model.robot, s.motion, reference)

    @cached_property
    def effect_columns(self) -> ca.SX:
        """Columns of the effects (n, m).

        Raises `ExportError`: an effect needs more than one instant.
        """
        s = self._symbols
        columns = self._model.effect_columns(s.signals, self._shapes, s.states)
        torque = s.load + ca.mtimes(columns, self._coefficients)
        arm = ArmInstant(self._model.robot, s.motion, self._links, self._all_links, s.load, torque)
        return with_arm_effects(columns, self._model, arm, self._coefficients)

    @cached_property
    def base_regressor(self) -> ca.SX:
        """Y_b (n, p), effects included."""
        kept = [int(k) for k in self._model.base.kept]
        return ca.horzcat(self.regressor, self.effect_columns)[:, kept]

    @cached_property
    def friction(self) -> ca.SX:
        """Torque of all effects (n,)."""
        return ca.mtimes(self.effect_columns, self._coefficients)

    @cached_property
    def torque(self) -> ca.SX:
        """Rigid torque and effects (n,), the load being that rigid torque."""
        return self.rigid_torque + self.with_load(self.friction)

    @cached_property
    def _torque_of_drives(self) -> TorqueExpressions:
        """Torque with all effects but those on the measurement, in symbols of its own."""
        arm_effects = any(isinstance(p.effect, ArmEffect) for p in self._model.placements)
        links = self._all_links if arm_effects else self._links
        values = Values(links, self._coefficients, self._shapes, numeric=False)
        return TorqueExpressions(
            self._model, values, None, as_measured=False, payload=False, sign=self._symbols.sign
        )

    def _in_own_symbols(self, expression: ca.SX) -> ca.SX:
        """Replace the symbols of `_torque_of_drives`."""
        theirs, s = self._torque_of_drives, self._symbols
        m = theirs.motion
        before = [m.q, m.dq, theirs.tau, theirs.states, theirs.temperature, theirs.time]
        after = [s.motion.q, s.motion.dq, s.torque, s.states, s.temperature, s.time]
        return ca.substitute([expression], before, after)[0]

    @cached_property
    def forward_dynamics(self) -> ca.SX:
        """q̈ (n,) for the torque that the drives deliver."""
        return self._in_own_symbols(forward_dynamics.acceleration(self._torque_of_drives))

    @cached_property
    def loaded_mass_matrix(self) -> ca.SX:
        """M (n, n) of forward dynamics: with armature and payload."""
        return self._in_own_symbols(self._torque_of_drives.mass_matrix)

    def with_load(self, expression: ca.SX) -> ca.SX:
        """Replace the load by the rigid torque."""
        return ca.substitute(expression, self._symbols.load, ca.densify(self.rigid_torque))

    def advance(self, before: ExportSymbols) -> ca.SX:
        """Return the states (S,) at this sample from those at the sample before."""
        return self._model.advance(
            before.signals, self._symbols.signals, self._shapes, before.states
        )


def model_numbers(fit: Fit, runtime: Collection[str]) -> ModelNumbers:
    """Return the identified numbers, those of ``runtime`` as symbols.

    ``runtime``: of ``parameters`` (link parameters, coefficients and shape parameters) and
    ``payload``.
    """
    values = {
        "link_parameters": fit.link_parameters,
        "effect_coefficients": fit.effect_coefficients,
        "shapes": fit.shapes,
    }
    inputs: dict[str, ca.SX] = {}
    if "parameters" in runtime:
        inputs = {name: ca.SX.sym(name, len(x)) for name, x in values.items() if len(x)}
    links, coefficients, shapes = (inputs.get(name, ca.SX(ca.DM(x))) for name, x in values.items())
    fewer = links if "parameters" in runtime else ca.SX(ca.DM(fewer_parameters(fit)))
    if "payload" in runtime:
        inputs["payload"] = body = ca.SX.sym("payload", 10)
        fewer, links = (with_body(x, body, fit.model) for x in (fewer, links))
    return ModelNumbers(fewer, links, coefficients, shapes, inputs)


def fewer_parameters(fit: Fit) -> Array:
    """Return link parameters (10 n,) with the same torque and as many zeros as possible.

    Only the parameters that head a rigid base parameter are not zero. If rounding in the geometry
    of the robot would change the torque, the link parameters of the fit are returned.
    """
    robot, links = fit.model.robot, fit.link_parameters
    base: BaseParameters = base_parameters(robot)
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
