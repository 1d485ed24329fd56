"""Functions of a fitted model for export: expressions with the identified numbers as constants."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from lieid_casadi.dynamics import closed_form, recursion
from lieid_casadi.dynamics.base_parameters import BaseParameters, base_parameters
from lieid_casadi.dynamics.motion_symbols import Motion
from lieid_casadi.dynamics.regressor import regressor, slotine_li_regressor
from lieid_casadi.effects.signals import EffectSignals
from lieid_casadi.exporters.c_arm_effects import with_arm_effects
from lieid_casadi.exporters.c_statements import FunctionBody, FunctionInput, body, each, number
from lieid_casadi.expressions.instant import ArmInstant
from lieid_casadi.identification.fit import Fit

Array = NDArray[np.float64]
AGREEMENT = 1e-13  # of the torque with fewer parameters, relative; the self-test requires 1e-12


@dataclass(frozen=True, eq=False)
class ExportSymbols:
    """Symbols on which exported functions depend, (n,) unless stated."""

    motion: Motion
    dq_r: ca.SX
    ddq_r: ca.SX
    sign: ca.SX
    load: ca.SX
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
            temperature=column("temperature"),
            time=column("time", 1),
            states=column("states", len(fit.model.states)),
        )

    @property
    def signals(self) -> EffectSignals:
        """The signals of effects."""
        m = self.motion
        return EffectSignals(m.q, m.dq, m.ddq, self.sign, self.load, self.temperature, self.time)


class ExportExpressions:
    """Functions of a model for given link parameters, coefficients and shape parameters.

    Parameters
    ----------
    fit : Fit
    symbols : ExportSymbols
        Symbols of the sample.
    links : (10 n,) ca.SX
        Link parameters: numbers, or symbols for the evaluation in the self-test.
    coefficients : (m,) ca.SX
        Coefficients of the effects, numbers or symbols.
    shapes : (s,) ca.SX
        Shape parameters, numbers or symbols.
    all_links : (10 n,) ca.SX, optional
        The identified link parameters, if ``links`` is a reduced set: in another direction of
        gravity, more parameters have an effect.
    """

    def __init__(
        self,
        fit: Fit,
        symbols: ExportSymbols,
        links: ca.SX,
        coefficients: ca.SX,
        shapes: ca.SX,
        all_links: ca.SX | None = None,
    ) -> None:
        self._fit, self._model, self._symbols = fit, fit.model, symbols
        self._links, self._coefficients, self._shapes = links, coefficients, shapes
        self._all_links = links if all_links is None else all_links

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

        Raises
        ------
        ExportError
            An effect needs more than one instant.
        """
        s = self._symbols
        columns = self._model.effect_columns(s.signals, self._shapes, s.states)
        torque = s.load + ca.mtimes(columns, self._coefficients)
        arm = ArmInstant(self._model.robot, s.motion, self._links, self._all_links, s.load, torque)
        return with_arm_effects(columns, self._model, arm, self._fit.effect_coefficients)

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

    def with_load(self, expression: ca.SX) -> ca.SX:
        """Replace the load by the rigid torque."""
        return ca.substitute(expression, self._symbols.load, ca.densify(self.rigid_torque))

    def advance(self, before: ExportSymbols) -> ca.SX:
        """Return the states (S,) at this sample from those at the sample before."""
        return self._model.advance(
            before.signals, self._symbols.signals, self._shapes, before.states
        )


def folded(fit: Fit, symbols: ExportSymbols) -> ExportExpressions:
    """Return the functions of the model with the identified numbers as constants."""
    return ExportExpressions(
        fit,
        symbols,
        ca.SX(ca.DM(fewer_parameters(fit))),
        ca.SX(ca.DM(fit.effect_coefficients)),
        ca.SX(ca.DM(fit.shapes)),
        ca.SX(ca.DM(fit.link_parameters)),
    )


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


@dataclass(frozen=True, eq=False)
class ExportedFunctions:
    """Bodies of the C functions by name, and what the states of effects depend on."""

    bodies: dict[str, FunctionBody]
    advance: FunctionBody | None
    remembers_load: bool
    advance_reads_load: bool


def functions(fit: Fit) -> ExportedFunctions:
    """Return the C of every function.

    Raises
    ------
    ExportError
        An effect uses an operation without a C form, or needs more than one instant.
    """
    now, before = ExportSymbols.of(fit), ExportSymbols.of(fit, "before_")
    expressions = folded(fit, now)
    motion = rigid_inputs(now)
    references = motion | {
        "dq_r": each(now.dq_r, "dq_r[{j}]"),
        "ddq_r": each(now.ddq_r, "ddq_r[{j}]"),
    }
    sample = sample_inputs(fit, now, of="sample->")
    loaded = sample | {"load": each(now.load, "load[{j}]")}
    bodies = {
        "rigid_torque": body(expressions.rigid_torque, motion, to="torque"),
        "gravity": body(expressions.gravity, motion, to="torque"),
        "mass_matrix": body(expressions.mass_matrix, motion, to="matrix"),
        "regressor": body(expressions.regressor, motion, to="matrix"),
        "slotine_li_regressor": body(expressions.slotine_li_regressor, references, to="matrix"),
        "base_regressor": body(expressions.base_regressor, loaded, to="matrix"),
        "friction": body(expressions.friction, loaded, to="torque"),
        "torque": body(expressions.torque, sample, to="torque"),
    }
    if fit.model.columns:
        bodies["effect_columns"] = body(expressions.effect_columns, loaded, to="matrix")
    if not fit.model.states:
        return ExportedFunctions(bodies, None, False, False)
    after = expressions.advance(before)
    past = sample_inputs(fit, before, of="state->before.")
    past["load"] = each(before.load, "state->before_load[{j}]")
    inputs = loaded | {f"before_{name}": given for name, given in past.items()}
    inputs["states"] = inputs.pop("before_states")
    advance = body(ca.densify(after), inputs, to="after")
    remembers = "before_load" in advance.used
    return ExportedFunctions(bodies, advance, remembers, remembers or "load" in advance.used)


def rigid_inputs(symbols: ExportSymbols, *, of: str = "") -> dict[str, FunctionInput]:
    """Return the inputs of functions of the motion alone; ``of`` is the expression of a sample."""
    motion = symbols.motion
    return {
        "q": each(motion.q, of + "q[{j}]"),
        "sin": each(motion.sin, f"sin({of}q[{{j}}])"),
        "cos": each(motion.cos, f"cos({of}q[{{j}}])"),
        "dq": each(motion.dq, of + "dq[{j}]"),
        "ddq": each(motion.ddq, of + "ddq[{j}]"),
    }


def sample_inputs(fit: Fit, symbols: ExportSymbols, *, of: str) -> dict[str, FunctionInput]:
    """Return the inputs of functions of a whole sample and the state.

    Parameters
    ----------
    fit : Fit
    symbols : ExportSymbols
    of : str
        C expression of the sample, such as ``sample->``.
    """
    mean = fit.temperature_mean
    warmth = [
        f"{of}temperature[{j}]" + (f" - {number(mean[j])}" if mean is not None else "")
        for j in range(fit.model.n)
    ]
    return rigid_inputs(symbols, of=of) | {
        "sign": each(symbols.sign, f"lieid_direction({of}dq[{{j}}], v0, {{j}})"),
        "temperature": FunctionInput(symbols.temperature, tuple(warmth)),
        "time": FunctionInput(symbols.time, (f"{of}time",)),
        "states": each(symbols.states, "state->values[{j}]"),
    }
