"""What a physical effect is, and the register of all effects by name.

An effect is written once, as CasADi columns per joint. The fit, the prediction, the generated
C, the regressor that an excitation sees and the candidates of a diagnosis all use that one
definition.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import ClassVar

import casadi as ca
import numpy as np

from lieid_casadi.errors import EffectError


@dataclass(frozen=True)
class Coefficient:
    """A linear coefficient; ``unit`` as for a revolute joint."""

    name: str
    unit: str
    lower: float = -np.inf
    upper: float = np.inf


@dataclass(frozen=True)
class Shape:
    """A shape parameter, on which the torque depends nonlinearly; bounds are finite.

    It is searched on a logarithmic scale where ``lower`` is above zero, else on a linear one.
    Where a small change makes another column altogether, as with the order of a harmonic,
    ``scan`` is the step of a linear search through the range.
    """

    name: str
    unit: str
    initial: float
    lower: float
    upper: float
    scan: float | None = None


@dataclass(frozen=True)
class State:
    """A number that an effect with memory carries from sample to sample.

    ``initial`` is its value at the first sample of every segment.
    """

    name: str
    unit: str
    initial: float = 0.0


@dataclass(frozen=True)
class Signals:
    """Symbols (scalars) of one joint that an effect may use.

    Attributes
    ----------
    q, dq, ddq
        Motion (rad, rad/s, rad/s²; m for a sliding joint).
    sign
        sgn(q̇), zero inside the dead zone; a smooth version where gradients are needed.
    load
        τ_load, the model's rigid torque on the joint, payload included (N·m).
    temperature
        °C, relative to the mean of the training recordings.
    time
        s since the start of the segment.
    other
        Signals of the joint that acts on this one, for couplings.
    state
        The effect's own states at this sample, by name.
    """

    q: ca.SX
    dq: ca.SX
    ddq: ca.SX
    sign: ca.SX
    load: ca.SX
    temperature: ca.SX
    time: ca.SX
    other: Signals | None = None
    state: Mapping[str, ca.SX] = field(default_factory=dict)


class Effect(ABC):
    """One physical effect on one joint: τ_i += Σ coefficient · column(signals, shapes).

    Subclasses state the class attributes and write `columns`; with memory, also ``states`` and
    `advance`. ``signals`` names what they use. Dry friction, which is undetermined at rest, is
    told by the signal ``sign`` or, in its absence, by ``dry``. Register a subclass with
    `register`, or use the `effect` decorator on a function.
    """

    name: ClassVar[str]
    formula: str
    coefficients: tuple[Coefficient, ...]
    shapes: tuple[Shape, ...] = ()
    states: tuple[State, ...] = ()
    signals: tuple[str, ...] = ("dq",)
    dry: bool = False  # undetermined at rest, although no column has the sign
    couples: ClassVar[bool] = False
    energy: ClassVar[str | None] = None  # "armature" or "offset": what links can imitate
    option: str = ""

    @abstractmethod
    def columns(self, s: Signals, shape: Mapping[str, ca.SX]) -> Sequence[ca.SX]:
        """Return one expression per linear coefficient."""

    def advance(self, before: Signals, now: Signals, shape: Mapping[str, ca.SX]) -> Sequence[ca.SX]:
        """Return the states at the sample ``now``, one expression per state.

        ``before`` holds the signals of the sample before it, and ``before.state`` the states
        there. Motion between two samples is theirs to bridge: nothing is said about the rate.
        """
        raise NotImplementedError(f"effect {self.name} has states but no advance")

    @property
    def label(self) -> str:
        """Name with its option, as written on the command line: ``stribeck/two_width``."""
        return f"{self.name}/{self.option}" if self.option else self.name

    def __repr__(self) -> str:
        return f"<effect {self.label}: {self.formula}>"


REGISTER: dict[str, Callable[[], Effect]] = {}


def register(kind: type[Effect], *, options: Sequence[str] = ()) -> type[Effect]:
    """Make an effect known by its name, and by ``name/option`` for each option.

    Raises
    ------
    EffectError
        If the name is taken by another effect.
    """
    for option in ("", *options):
        label = f"{kind.name}/{option}" if option else kind.name
        known = REGISTER.get(label)
        if known is not None and getattr(known, "kind", None) is not kind:
            raise EffectError(f"effect name {label!r} is taken; choose another name")
        REGISTER[label] = _Maker(kind, option)
    return kind


@dataclass(frozen=True)
class _Maker:
    kind: type[Effect]
    option: str

    def __call__(self) -> Effect:
        return self.kind(option=self.option) if self.option else self.kind()  # type: ignore[call-arg]


def effect(
    name: str,
    *,
    formula: str,
    coefficients: Mapping[str, str],
    shapes: Sequence[Shape] = (),
    signals: Sequence[str] = ("q", "dq", "sign"),
    couples: bool = False,
) -> Callable[[Callable[..., Sequence[ca.SX]]], type[Effect]]:
    """Register a function ``columns(signals, shape)`` as an effect.

    Parameters
    ----------
    coefficients : mapping
        Linear coefficient → unit, in the order of the returned columns.
    couples : bool
        Whether another joint acts on this one: its signals are ``signals.other``, and the effect
        is placed on pairs, ``name:5<6``.

    Examples
    --------
    >>> import casadi as ca
    >>> @effect("cogging6", formula="a·sin(6q)", coefficients={"a": "N·m"}, signals=["q"])
    ... def cogging(s, shape):
    ...     return [ca.sin(6 * s.q)]
    >>> make("cogging6")
    <effect cogging6: a·sin(6q)>
    """

    def wrap(function: Callable[..., Sequence[ca.SX]]) -> type[Effect]:
        members = {
            "__doc__": function.__doc__,
            "name": name,
            "formula": formula,
            "coefficients": tuple(Coefficient(key, unit) for key, unit in coefficients.items()),
            "shapes": tuple(shapes),
            "signals": tuple(signals),
            "couples": couples,
            "columns": lambda self, s, shape: function(s, shape),
        }
        return register(type(name, (Effect,), members))

    return wrap


def make(label: str) -> Effect:
    """Return the effect of a name or ``name/option``.

    Raises
    ------
    EffectError
        If no effect has that name; the message lists those that exist.
    """
    if label not in REGISTER:
        known = ", ".join(sorted(REGISTER))
        raise EffectError(
            f"unknown effect {label!r}; expected one of {known}, "
            "or an effect of your own given with --effects-file"
        )
    return REGISTER[label]()
