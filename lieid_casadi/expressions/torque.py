"""The torque of a model and its parts as expressions of one set of symbols."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from difflib import get_close_matches
from functools import cached_property
from typing import Any

import casadi as ca
import numpy as np

from lieid_casadi.arrays import Array
from lieid_casadi.dynamics import closed_form, recursion
from lieid_casadi.dynamics.lie import Motion, tool_pose
from lieid_casadi.dynamics.regressor import regressor
from lieid_casadi.effects import ArmEffect, InstantModel
from lieid_casadi.effects.effect import EffectSignals
from lieid_casadi.errors import ModelError
from lieid_casadi.expressions.model_functions import ramp
from lieid_casadi.model import Model


@dataclass(frozen=True, eq=False)
class Values:
    """Parameters of a model: numbers or symbols."""

    parameters: ca.SX  # (10 n,) of the links
    effects: ca.SX  # (m,) coefficients
    shapes: ca.SX  # (s,)
    numeric: bool
    temperature_mean: Array | None = None  # (n,) °C, subtracted from the temperature
    #: groups that are symbols while the others are numbers, by the name of their input
    free: dict[str, FreeGroup] = field(default_factory=dict)

    @classmethod
    def numbers(
        cls, parameters: Array, effects: Array, shapes: Array,
        temperature_mean: Array | None = None,
    ) -> Values:  # fmt: skip
        """Return constants: link parameters (10 n,), coefficients (m,), shapes (s,), means (n,)."""
        links, coefficients, shape = (ca.SX(ca.DM(x)) for x in (parameters, effects, shapes))
        return cls(links, coefficients, shape, True, temperature_mean)

    @classmethod
    def symbols(cls, model: Model, temperature_mean: Array | None = None) -> Values:
        """Return symbols in the sizes of a model."""
        links = ca.SX.sym("parameters", 10 * model.n)
        coefficients = ca.SX.sym("effects", len(model.columns))
        shapes = ca.SX.sym("shapes", len(model.shapes))
        return cls(links, coefficients, shapes, False, temperature_mean)

    def with_free(self, model: Model, groups: Sequence[str]) -> Values:
        """Return numbers of which groups are symbols, such as ``friction:3`` or ``link6``."""
        numbers = ca.vertcat(self.parameters, self.effects, self.shapes)
        labels = [p.label for p in (*model.link_parameters, *model.columns, *model.shapes)]
        taken, free = np.full(len(labels), "", dtype=object), {}
        symbols = ca.SX(numbers)
        for group in groups:
            members = _members(model, group)
            twice = [k for k in members if taken[k]]
            if twice:
                raise ModelError(f"free: {labels[twice[0]]} is in {taken[twice[0]]} and {group}")
            taken[members] = group
            name = re.sub(r"\W+", "_", group)
            symbol = ca.SX.sym(name, len(members))
            symbols[members] = symbol
            values = np.array(ca.DM(numbers[members])).ravel()
            free[name] = FreeGroup(symbol, tuple(labels[k] for k in members), values)
        ends = np.cumsum([0, self.parameters.size1(), self.effects.size1(), self.shapes.size1()])
        links, effects, shapes = ca.vertsplit(symbols, [int(end) for end in ends])
        return Values(links, effects, shapes, not free, self.temperature_mean, free)

    @property
    def inputs(self) -> dict[str, ca.SX]:
        """The symbols among them by name, those of size 0 left out."""
        if self.numeric:
            return {}
        if self.free:
            return {name: group.symbol for name, group in self.free.items()}
        named = {"parameters": self.parameters, "effects": self.effects, "shapes": self.shapes}
        return {name: symbol for name, symbol in named.items() if symbol.size1()}


@dataclass(frozen=True, eq=False)
class FreeGroup:
    """Parameters that are one input (k,): its symbol, their labels, and their identified values."""

    symbol: ca.SX
    labels: tuple[str, ...]
    nominal: Array


def _members(model: Model, group: str) -> list[int]:
    """Return the places of a group among link parameters, coefficients and shapes."""
    name, _, where = group.partition(":")
    n, count = model.n, len(model.columns)
    joints = set(range(n))
    if where:
        stated = [int(j) for j in where.split("+") if j.isdecimal()]
        if len(stated) != len(where.split("+")) or not set(stated) <= set(range(1, n + 1)):
            raise ModelError(f"free: {group!r} names no joints 1 to {n}; expected such as {name}:1")
        joints = {j - 1 for j in stated}
    links = [f"link{j + 1}" for j in range(n)]
    if name in links and not where:
        first = 10 * links.index(name)
        return list(range(first, first + 10))
    found, every = list[int](), range(10 * n, 10 * n + count + len(model.shapes))
    for slot in model.slots:
        p = slot.placement
        own = [*every[slot.columns], *every[count:][slot.shapes]]
        single = not p.whole_arm and not isinstance(p.effect, ArmEffect)
        friction = name == "friction" and single and p.effect.name != "armature"
        if (friction or name in (p.effect.name, p.effect.label)) and p.joint in joints:
            found += own
    if found:
        return sorted(found)
    known = ["friction", "payload", *links, *sorted({p.effect.name for p in model.placements})]
    near = [] if name.startswith("link") else get_close_matches(name, known, 1)
    hint = f"did you mean {near[0]}?" if near and near[0] != name else (
        f"expected some of {', '.join(known)}, with joints as in friction:3"
    )  # fmt: skip
    raise ModelError(f"free: the model has no parameters {group!r}; {hint}")


def named_function(
    name: str, inputs: Mapping[str, ca.SX], outputs: Mapping[str, ca.SX], **options: Any
) -> ca.Function:
    """Return a function of named inputs and dense outputs, common subexpressions evaluated once."""
    return ca.Function(
        name, list(inputs.values()), [ca.densify(value) for value in outputs.values()],
        list(inputs), list(outputs),
        {"cse": True, "allow_duplicate_io_names": True, **options},  # a symbol g, the result g
    )  # fmt: skip


def arm_effect_columns(
    model: Model, arm: InstantModel, coefficients: ca.SX, *, measurement: bool
) -> ca.SX:
    """Return the columns (n, m) of effects on the whole arm or on the measurement; others are zero.

    Raises `ModelError`: an effect on the measurement depends on the motion before the instant.
    """
    columns = ca.SX(model.n, len(model.columns))
    for slot in model.slots:
        p = slot.placement
        if isinstance(p.effect, ArmEffect) and p.effect.on_measurement == measurement:
            if p.effect.needs_past:
                raise ModelError(
                    f"{p.label}: the measured torque depends on the motion before the instant; "
                    "expected a model without this effect, or as_measured=False"
                )
            now = p.effect.instant_columns(arm, p.joint, coefficients[slot.columns])
            if now is not None:
                columns[:, slot.columns] = now
    return columns


class TorqueExpressions:
    """Torque of a model and its parts, in symbols that this object holds.

    ``smooth_velocity`` (n,): half widths in rad/s of the smooth sign of the velocity; None is the
    sign itself; ``as_measured``: whether effects of the measurement are part of the torque;
    ``payload``: whether ten link parameters of a body at the tool are a further symbol; ``sign``
    (n,): symbol in place of the sign of the velocity; ``command_error`` (n,): commanded minus
    measured position, rad, for effects of position-controlled drives; zero if left out: the torque
    is then that which the drives deliver; ``motion``: symbols of the motion; its own if left out.
    """

    def __init__(
        self,
        model: Model,
        values: Values,
        smooth_velocity: Array | None,
        *,
        as_measured: bool,
        payload: bool,
        sign: ca.SX | None = None,
        command_error: ca.SX | None = None,
        motion: Motion | None = None,
    ) -> None:
        self.model, self.values = model, values
        self.n = n = model.n
        self.motion = motion or Motion.of(*(ca.SX.sym(name, n) for name in ("q", "dq", "ddq")))
        dq = self.motion.dq
        self.tau = ca.SX.sym("tau", n)
        self.load = ca.SX.sym("load", n)
        self.states = ca.SX.sym("states", len(model.states))
        self.temperature = ca.SX.sym("temperature", n)
        self.time = ca.SX.sym("time")
        self.payload = ca.SX.sym("payload", 10) if payload else None
        if sign is None:
            width = smooth_velocity
            sign = ca.sign(dq) if width is None else ramp(dq, ca.SX(ca.DM(width)))
        self._sign = sign
        self._command_error = ca.SX(0) if command_error is None else command_error
        self._as_measured = as_measured
        _ = self.measurement_columns  # refuses effects that depend on more than one instant

    @property
    def leading_symbols(self) -> dict[str, ca.SX]:
        """Symbols of the motion and the torque by name."""
        m = self.motion
        return {"q": m.q, "dq": m.dq, "ddq": m.ddq, "tau": self.tau, "load": self.load}

    def further_inputs(self, *, static: bool = False) -> dict[str, ca.SX]:
        """Return the inputs that the model adds; ``static`` without states, temperature, time."""
        inputs = {} if static else dict(self._signal_inputs)
        if self.payload is not None:
            inputs["payload"] = self.payload
        return inputs | self.values.inputs

    @cached_property
    def _signal_inputs(self) -> dict[str, ca.SX]:
        """States, temperature and time, where the torque depends on them."""
        torque = ca.vertcat(self.inverse_dynamics, self.state_rates)
        states = {"states": self.states} if self.states.size1() else {}
        signals = {"temperature": self.temperature, "time": self.time}
        return states | {k: v for k, v in signals.items() if ca.depends_on(torque, v)}

    @cached_property
    def links(self) -> ca.SX:
        """Link parameters (10 n,), with the body of the input ``payload``."""
        if self.payload is None:
            return self.values.parameters
        return with_body(self.values.parameters, self.payload, self.model)

    @cached_property
    def all_links(self) -> ca.SX:
        """Link parameters (10 n,), with bodies that effects on the whole arm add at the tool."""
        links = self.links
        for slot in self.model.slots:
            if isinstance(slot.placement.effect, ArmEffect):
                body = slot.placement.effect.tool_body(self.values.effects[slot.columns])
                if body is not None:
                    links = with_body(links, body, self.model)
        return links

    @cached_property
    def rigid_torque(self) -> ca.SX:
        """Torque (n,) of the links: the load that friction depends on."""
        return recursion.inverse_dynamics(self.model.robot, self.motion, self.links)

    @cached_property
    def _signals(self) -> EffectSignals:
        m = self.motion
        mean = self.values.temperature_mean
        temperature = self.temperature if mean is None else self.temperature - ca.SX(ca.DM(mean))
        return EffectSignals(
            m.q, m.dq, m.ddq, self._sign, self.load, temperature, self.time, self._command_error
        )

    @cached_property
    def joint_columns(self) -> ca.SX:
        """Columns (n, m) of effects on single joints, of the symbol ``load``."""
        return self.model.effect_columns(self._signals, self.values.shapes, self.states)

    @cached_property
    def joint_torque(self) -> ca.SX:
        """Torque (n,) of effects on single joints, of the symbol ``load``."""
        return ca.densify(ca.mtimes(self.joint_columns, self.values.effects))

    @cached_property
    def _instant(self) -> InstantModel:
        torque = self.load + self.joint_torque
        return InstantModel(self.model.robot, self.motion, self.links, self.load, torque)

    @cached_property
    def arm_columns(self) -> ca.SX:
        """Columns (n, m) of effects on the whole arm."""
        coefficients = self.values.effects
        return arm_effect_columns(self.model, self._instant, coefficients, measurement=False)

    @cached_property
    def measurement_columns(self) -> ca.SX:
        """Columns (n, m) of effects on the measurement; zero unless asked for."""
        if not self._as_measured:
            return ca.SX(self.n, len(self.model.columns))
        coefficients = self.values.effects
        return arm_effect_columns(self.model, self._instant, coefficients, measurement=True)

    @cached_property
    def arm_torque(self) -> ca.SX:
        """Torque (n,) of effects on the whole arm."""
        return ca.densify(ca.mtimes(self.arm_columns, self.values.effects))

    @cached_property
    def measurement_torque(self) -> ca.SX:
        """What effects on the measurement add to the torque (n,); zero unless asked for."""
        return ca.densify(ca.mtimes(self.measurement_columns, self.values.effects))

    @cached_property
    def loaded_torque(self) -> ca.SX:
        """Torque (n,) as a function of the motion and of the symbol ``load`` in friction."""
        return self.rigid_torque + self.joint_torque + self.arm_torque + self.measurement_torque

    @cached_property
    def inverse_dynamics(self) -> ca.SX:
        """Torque (n,) with all effects."""
        return ca.substitute(self.loaded_torque, self.load, self.rigid_torque)

    @cached_property
    def uses_load(self) -> bool:
        """Whether the torque of effects on single joints depends on the load."""
        return bool(ca.depends_on(self.joint_torque, self.load))

    @cached_property
    def armature(self) -> ca.SX:
        """Derivative (n, n) of the torque of effects on single joints by the acceleration."""
        return ca.jacobian(self.joint_torque, self.motion.ddq)

    @cached_property
    def link_mass_matrix(self) -> ca.SX:
        """∂load/∂q̈ (n, n): the mass matrix of the links whose torque is the load."""
        return closed_form.mass_matrix(self.model.robot, self.motion, self.links)

    @cached_property
    def rigid_mass_matrix(self) -> ca.SX:
        """M (n, n) of the links and the payload."""
        return closed_form.mass_matrix(self.model.robot, self.motion, self.all_links)

    @cached_property
    def mass_matrix(self) -> ca.SX:
        """M (n, n), armature included: that at rest, where it depends on the motion."""
        m, zero = self.motion, ca.SX.zeros(self.n)
        (armature,) = ca.substitute([self.armature], [m.dq, m.ddq], [zero, zero])
        return self.rigid_mass_matrix + armature

    @cached_property
    def coriolis(self) -> ca.SX:
        """C (n, n) with Ṁ − 2C skew-symmetric."""
        return closed_form.coriolis_matrix(self.model.robot, self.motion, self.all_links)

    @cached_property
    def gravity(self) -> ca.SX:
        """Torque (n,) at rest: gravity, and effects on the whole arm."""
        zero, m = ca.SX.zeros(self.n), self.motion
        beside = ca.substitute([self.arm_torque], [m.dq, m.ddq], [zero, zero])[0]
        return closed_form.gravity(self.model.robot, m, self.links) + beside

    @cached_property
    def friction(self) -> ca.SX:
        """Torque (n,) of effects on single joints, armature left out; of the symbol ``load``."""
        return ca.substitute(self.joint_torque, self.motion.ddq, ca.SX.zeros(self.n))

    @cached_property
    def base_regressor(self) -> ca.SX:
        """Torque per base parameter (n, p), of the symbol ``load``."""
        columns = self.joint_columns + self.arm_columns + self.measurement_columns
        kept = [int(k) for k in self.model.base.kept]
        return ca.horzcat(regressor(self.model.robot, self.motion), columns)[:, kept]

    @cached_property
    def state_rates(self) -> ca.SX:
        """Time derivatives (S,) of the states of effects with memory, in continuous time."""
        return self.model.state_rates(self._signals, self.values.shapes, self.states)


def with_body(links: ca.SX, body: ca.SX, model: Model) -> ca.SX:
    """Return link parameters (10 n,) with those of a body (10,) in the tool frame added."""
    at_link = closed_form.seen_from_parent(tool_pose(model.robot), body)
    return ca.vertcat(links[:-10], links[-10:] + at_link)
