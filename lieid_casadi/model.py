"""A model: a robot and the physical effects on its joints, as CasADi expressions."""

from __future__ import annotations

import sys
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Literal

import casadi as ca
import numpy as np

from lieid_casadi.arrays import Array
from lieid_casadi.dynamics.base_parameters import BaseParameters, EnergyColumn, base_parameters
from lieid_casadi.effects import Effect, Placement, parse_effects, place
from lieid_casadi.effects.effect import EffectSignals
from lieid_casadi.effects.placement import labels
from lieid_casadi.effects.registry import REGISTER, Library, usable
from lieid_casadi.errors import LieidWarning, ModelError, UnusableEffectWarning
from lieid_casadi.robot import Robot
from lieid_casadi.robot.inertia import LINK_PARAMETER_NAMES, LINK_PARAMETER_UNITS


def as_model(source: Model | Robot) -> Model:
    """Return a model; of a robot, that without effects."""
    if isinstance(source, Robot):
        return Model(source)
    if not isinstance(source, Model):
        raise ModelError(
            f"got {source!r:.60}; expected a Model or a Robot, such as Model(Robot.load(path))"
        )
    return source


@dataclass(frozen=True)
class Parameter:
    """A parameter of a model: of a link, or a coefficient or shape parameter of an effect."""

    name: str
    joint: int  # from 0
    unit: str
    lower: float = -np.inf  # bounds of the physics
    upper: float = np.inf
    initial: float = 0.0
    fitted: bool = True  # False for what the training gives, such as the end of a signal's range
    source: int | None = None  # from 0: the joint whose motion acts, of a coupling

    @property
    def label(self) -> str:
        """Name with its joints from 1: ``Izz3``, ``stribeck.v_s:4``, ``….f_c:5<6``."""
        between = ":" if "." in self.name else ""
        acting = "" if self.source is None else f"<{self.source + 1}"
        return f"{self.name}{between}{self.joint + 1}{acting}"

    def belongs_to(self, placement: Placement) -> bool:
        """Return whether it is a parameter of a placed effect."""
        effect, own = self.name.rpartition(".")[0], (self.joint, self.source)
        return effect == placement.effect.label and own == (placement.joint, placement.source)


@dataclass(frozen=True)
class Slot:
    """A placed effect, and the places of what it has among the columns, shapes and states."""

    placement: Placement
    columns: slice
    shapes: slice
    states: slice


class Model:
    """A serial arm with physical effects on its joints.

    Parameters
    ----------
    robot : Robot
    effects : str or sequence of str or Effect
        E.g. ``["coulomb", "stribeck:4"]`` (joints from 1 in text) or ``"coulomb,viscous"``.
    library : mapping, optional
        Effects that a search for missing effects may add, by label; by default those that are
        registered now.

    Raises
    ------
    EffectError
        Unknown effect or joint.

    Examples
    --------
    >>> import lieid_casadi as lieid
    >>> model = lieid.Model(lieid.robots.two_link(), effects=["coulomb", "viscous:2"])
    >>> [column.label for column in model.columns]
    ['coulomb.f_c:1', 'coulomb.f_c:2', 'viscous.f_v:2']
    """

    def __init__(
        self,
        robot: Robot,
        effects: str | Iterable[str | Effect] = (),
        *,
        library: Library | None = None,
    ) -> None:
        self.robot = robot
        self.library: Library = dict(REGISTER) if library is None else library
        self.placements: tuple[Placement, ...] = parse_effects(effects, robot.n)

    def __getstate__(self) -> dict[str, Any]:
        """Return what is pickled: the library without effects that no other process can import."""
        known = {
            label: variant
            for label, variant in self.library.items()
            if getattr(sys.modules.get(variant.kind.__module__), variant.kind.__qualname__, None)
            is variant.kind
        }
        return {**self.__dict__, "library": known}

    @classmethod
    def of_placements(
        cls, robot: Robot, placements: Sequence[Placement], *, library: Library | None = None
    ) -> Model:
        """Return a model with given placements, in their order; see `Model` for the library."""
        model = cls(robot, library=library)
        model.placements = tuple(placements)
        return model

    def with_effect(self, effect: str | Effect, *, joints: Sequence[int] | None = None) -> Model:
        """Return this model with one more effect, where it does not have it already.

        Parameters
        ----------
        effect : str or Effect
            Name, such as ``"stribeck"`` or, with joints from 1, ``"stribeck:4"``.
        joints : sequence of int, optional
            Joints from 0; every joint, or those in the name, if left out.

        Raises
        ------
        EffectError
            Unknown effect or joint.
        """
        have = {placement.label for placement in self.placements}
        new = [p for p in place(effect, self.robot.n, joints) if p.label not in have]
        return Model.of_placements(self.robot, (*self.placements, *new), library=self.library)

    def without(self, placement: Placement) -> Model:
        """Return this model without one placement."""
        rest = [p for p in self.placements if p.label != placement.label]
        return Model.of_placements(self.robot, rest, library=self.library)

    @property
    def unusable_effects(self) -> list[LieidWarning]:
        """A warning for each effect of the library whose code raises."""
        return [
            UnusableEffectWarning(f"{text}; it is left out")
            for text in usable(self.library)[1].values()
        ]

    @property
    def n(self) -> int:
        """Number of joints."""
        return self.robot.n

    @property
    def effects(self) -> list[str]:
        """The effects as they are written in files: ``["coulomb", "stribeck:4"]``."""
        return labels(self.placements, self.n)

    @cached_property
    def slots(self) -> tuple[Slot, ...]:
        """The placed effects with the places of their columns, shape parameters and states."""
        found: list[Slot] = []
        ends: tuple[int, ...] = (0, 0, 0)
        for p in self.placements:
            sizes = len(p.effect.coefficients), len(p.effect.shapes), len(p.effect.states)
            starts, ends = ends, tuple(a + n for a, n in zip(ends, sizes, strict=True))
            found.append(Slot(p, *(slice(a, b) for a, b in zip(starts, ends, strict=True))))
        return tuple(found)

    @cached_property
    def columns(self) -> tuple[Parameter, ...]:
        """The effects' linear coefficients, in the order of their columns."""
        return self._of("coefficients")

    @cached_property
    def shapes(self) -> tuple[Parameter, ...]:
        """The effects' shape parameters."""
        return self._of("shapes")

    @property
    def initial_shapes(self) -> Array:
        """Start values of the shape parameters (s,)."""
        return np.array([shape.initial for shape in self.shapes])

    @cached_property
    def states(self) -> tuple[Parameter, ...]:
        """What effects with memory carry along, in the order of the state vector."""
        return self._of("states")

    @property
    def initial_states(self) -> Array:
        """States at the first sample of a segment."""
        return np.array([state.initial for state in self.states])

    @cached_property
    def link_parameters(self) -> tuple[Parameter, ...]:
        """The 10 n link parameters."""
        return tuple(
            Parameter(name, joint, unit)
            for joint in range(self.n)
            for name, unit in zip(LINK_PARAMETER_NAMES, LINK_PARAMETER_UNITS, strict=True)
        )

    @cached_property
    def base(self) -> BaseParameters:
        """Base parameters of [Y, effect columns]."""
        energy = [
            EnergyColumn(p.effect.energy, p.joint) if p.effect.energy else None
            for p in self.placements
            for _ in p.effect.coefficients
        ]
        return base_parameters(self.robot, energy, [column.label for column in self.columns])

    @cached_property
    def base_columns(self) -> tuple[Parameter, ...]:
        """The kept columns as parameters (p,)."""
        every = (*self.link_parameters, *self.columns)
        return tuple(every[k] for k in self.base.kept)

    def effect_columns(
        self, signals: EffectSignals, shapes: ca.SX, states: ca.SX | None = None
    ) -> ca.SX:
        """Return the columns (n, m) of effects at ``signals``, ``shapes`` (s,), ``states`` (S,)."""
        matrix = ca.SX(self.n, len(self.columns))
        column = 0
        for p, shape, state in self._named(shapes, states):
            for expression in p.effect.columns(signals.of(p.joint, p.source, state), shape):
                matrix[p.joint, column] = expression
                column += 1
        return matrix

    def advance(
        self, before: EffectSignals, now: EffectSignals, shapes: ca.SX, states: ca.SX
    ) -> ca.SX:
        """Return ``states`` (S,) after a step from ``before`` to ``now``, with ``shapes`` (s,)."""
        after: list[ca.SX] = []
        for p, shape, state in self._named(shapes, states):
            if state:
                past = before.of(p.joint, p.source, state)
                after += p.effect.next_states(past, now.of(p.joint, p.source), shape)
        return ca.vertcat(*after)

    def state_rates(self, signals: EffectSignals, shapes: ca.SX, states: ca.SX) -> ca.SX:
        """Return the derivatives (S,) of ``states``, given ``signals`` and ``shapes`` (s,)."""
        rates: list[ca.SX] = []
        for p, shape, state in self._named(shapes, states):
            if state:
                rates += p.effect.state_rates(signals.of(p.joint, p.source, state), shape)
        return ca.vertcat(*rates)

    def _of(self, kind: Literal["coefficients", "shapes", "states"]) -> tuple[Parameter, ...]:
        """Return the parameters of one kind of all placed effects."""
        return tuple(
            Parameter(
                f"{p.effect.label}.{x.name}",
                p.joint,
                _unit(x.unit, p, self.robot),
                lower=getattr(x, "lower", -np.inf),
                upper=getattr(x, "upper", np.inf),
                initial=getattr(x, "initial", 0.0),
                fitted=getattr(x, "data", None) is None,
                source=p.source,
            )
            for p in self.placements
            for x in getattr(p.effect, kind)
        )

    def _named(
        self, shapes: ca.SX, states: ca.SX | None
    ) -> Iterator[tuple[Placement, dict[str, ca.SX], dict[str, ca.SX]]]:
        """Yield each placement with its own shape parameters and states by name."""
        if states is None and self.states:
            remembering = ", ".join(p.label for p in self.placements if p.effect.states)
            raise ModelError(f"{remembering} has memory; expected states beside the signals")
        for slot in self.slots:
            p = slot.placement
            shape = {s.name: shapes[slot.shapes.start + k] for k, s in enumerate(p.effect.shapes)}
            state = {
                s.name: states[slot.states.start + k]
                for k, s in enumerate(p.effect.states)
                if states is not None
            }
            yield p, shape, state

    def __repr__(self) -> str:
        return f"Model({self.robot.name}, effects={self.effects})"


def _unit(unit: str, placement: Placement, robot: Robot) -> str:
    """Return a unit as it reads for the effect's joint: a sliding joint has N and m."""
    if placement.whole_arm or robot.joints[placement.joint].revolute:
        return unit
    return unit.replace("kg·m²", "kg").replace("N·m", "N").replace("rad", "m")
