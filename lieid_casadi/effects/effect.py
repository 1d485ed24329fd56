"""Definition of a physical effect.

An effect is written once, as CasADi columns per joint. The fit, the prediction, the generated
C, the regressor of an excitation and the candidates of a diagnosis all use that definition.
"""

from __future__ import annotations

import sys
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import ClassVar, Literal, Protocol

import casadi as ca
import numpy as np

from lieid_casadi.errors import EffectError
from lieid_casadi.robot.drive import Drive

ShapeSymbols = Mapping[str, ca.SX]  # shape parameters by name
Columns = Sequence[ca.SX]  # one expression per linear coefficient


class SignalsOfJoints(Protocol):
    """The signals of several joints."""

    def of(self, joint: int) -> Signals:
        """Return the signals of a joint, from 0."""


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
    command_error
        Commanded minus measured position, rad; zero where there are no commands.
    other
        Signals of the joint that acts on this one, for couplings.
    state
        The effect's own states at this sample, by name.
    every
        The signals of all joints, for `joint`.
    """

    q: ca.SX
    dq: ca.SX
    ddq: ca.SX
    sign: ca.SX
    load: ca.SX
    temperature: ca.SX
    time: ca.SX
    command_error: ca.SX = field(default_factory=lambda: ca.SX(0))
    other: Signals | None = None
    state: Mapping[str, ca.SX] = field(default_factory=dict)
    every: SignalsOfJoints | None = None

    def joint(self, number: int) -> Signals:
        """Return the signals of another joint (from 0), one of `Effect.joints`."""
        assert self.every is not None
        return self.every.of(number)


@dataclass(frozen=True)
class EffectSignals(Signals):
    """The signals of all joints (n,), of which `of` selects those of one."""

    def of(
        self, joint: int, source: int | None = None, state: ShapeSymbols | None = None
    ) -> Signals:
        """Return the signals of a joint (from 0), with those of the ``source`` of a coupling."""
        signals = {name: x for name, x in vars(self).items() if isinstance(x, ca.SX)}
        return Signals(
            **{name: x if x.is_scalar() else x[joint] for name, x in signals.items()},
            other=None if source is None else self.of(source),
            state=state or {},
            every=self,
        )


@dataclass(frozen=True)
class Coefficient:
    """A linear coefficient of an effect.

    Attributes
    ----------
    name : str
    unit : str
        As for a revolute joint; models convert it for a prismatic one.
    lower, upper : float
        Bounds that physics sets, infinite where there are none.
    meaning : str
        One phrase for documentation.
    resolved_by : str
        ``"sample_time"`` if values smaller than one sampling interval cannot be resolved,
        ``"lead"`` if only negative ones cannot: a velocity that the drive computes by differences
        is late by up to one interval, so that the torque seems to lead. Empty otherwise.
    opposes_motion : bool
        Whether it is friction, so that a negative value is doubtful; a change of a fit may be
        negative.
    limit : float
        Size that no real arm exceeds, also of a change. A diagnosis names no larger value.
    prior : callable, optional
        Mean and standard deviation that are known before any data, from the sampling rate, Hz, and
        the control law of the joint's drive; None if they are not known.
    """

    name: str
    unit: str
    lower: float = -np.inf
    upper: float = np.inf
    meaning: str = ""
    resolved_by: Literal["", "sample_time", "lead"] = ""
    opposes_motion: bool = False
    limit: float = np.inf
    prior: Callable[[float, Drive | None], tuple[float, float] | None] | None = None


@dataclass(frozen=True)
class DataRange:
    """Where the training recordings give a shape parameter, in place of a fit."""

    signal: str  # a field of `Signals`
    joint: int | None  # from 0; None: the effect's own
    end: str  # of the signal's range, "low" or "high", or its largest "size"


@dataclass(frozen=True)
class Shape:
    """A shape parameter: the torque depends on it nonlinearly.

    It is searched on a logarithmic scale if ``lower`` is above zero, else on a linear one.

    Attributes
    ----------
    name, unit : str
    initial, lower, upper : float
        Start value and finite bounds.
    scan : float, optional
        Step of a linear search through the whole range, for parameters such as the order of a
        harmonic, where a small change gives an unrelated column.
    meaning : str
        One phrase for documentation.
    resolved_by : str
        What narrows the range that a recording can resolve: ``"duration"`` (a time constant, by
        the length of the segments), ``"speed"`` (a velocity, by the joint's dead zone and top
        speed), ``"distance"`` (a width, by the dead zone), ``"command_error"`` (an error of
        position control, to the upper part of the joint's errors), or empty (the bounds alone).
    data : DataRange, optional
        What it is in the training recordings; such a parameter is not fitted.
    """

    name: str
    unit: str
    initial: float
    lower: float
    upper: float
    scan: float | None = None
    meaning: str = ""
    resolved_by: Literal["", "duration", "speed", "distance", "command_error"] = ""
    data: DataRange | None = None


@dataclass(frozen=True)
class MemoryState:
    """A number that an effect with memory carries from sample to sample.

    ``initial`` is its value at the first sample of every segment.
    """

    name: str
    unit: str
    initial: float = 0.0


class Effect(ABC):
    """One physical effect on one joint: τ_i += Σ coefficient · column(signals, shapes).

    Subclasses set the class attributes and implement `columns`; effects with memory also set
    ``states`` and implement `advance`. Register a subclass with `register`, or use the `effect`
    decorator on a function.

    Attributes
    ----------
    name, formula : str
    coefficients : tuple of Coefficient
        In the order of the columns.
    shapes : tuple of Shape
    states : tuple of MemoryState
    signals : tuple of str
        The fields of `Signals` that the effect uses.
    joints : tuple of int
        Further joints, from 0, whose signals it uses by `Signals.joint`.
    dry : bool
        Whether the torque is undetermined at rest although no column contains the sign. Effects
        that use the signal ``sign`` are undetermined at rest anyway.
    couples : bool
        Whether the motion of another joint acts on this one.
    whole_arm : bool
        Whether the effect acts on no joint in particular.
    per_recording : bool
        Whether the coefficients hold for one recording only, as those of a drift.
    commanded : bool
        Whether it acts on drives under position control only: it needs commanded positions and
        their control law.
    on_torque_signal : bool
        Whether it acts on the signal of a torque sensor or current, which arms under position
        control do not have.
    like_uncertain_friction : tuple of str
        ``late``, ``early``: dry friction that reverses so looks much the same; ``rest``: that of a
        joint at rest, of which a filter adds a part to its motion. A diagnosis counts what the
        effect explains besides.
    energy : str or None
        ``"armature"`` or ``"offset"`` if link parameters can produce the same torque.
    option : str
        The variant of this instance, a key of ``options``.
    options : mapping
        The variants of the effect: option → one sentence.
    free_options : bool
        Whether ``options`` are examples, and the class refuses by itself what it cannot be.
    orthonormal : bool
        Whether the columns are orthonormal over the range of the data, so that the coefficients
        have one size, by which those that the data hardly determine are held.
    replaces : tuple of str
        Effects whose place this one takes; a model normally has one or the other.
    accompanied_by : tuple of str
        Effects that change whenever this one does, such as the offset of a spring.
    counted_as : tuple of str
        Effects that stand for this one in the regressor of a trajectory design.
    candidate : bool
        Whether a diagnosis tries it as a missing effect.
    unless_measured : str
        Signal that, where it is recorded and varies, describes the cause better: a diagnosis then
        does not try this effect.
    finding, change : tuple of str
        Sentence of a diagnosis for a missing effect, and for a change (empty: the same); two if it
        depends on the sign of the first coefficient, positive first. ``{joints}`` and
        ``{source}`` are replaced by the joints, ``{increased}`` by "increased" or "decreased".
    size_unit : str
        Unit in which these sentences state the first coefficient, if it is not the
        coefficient's own; ``%`` multiplies by 100.
    revealed_by : str
        The motion that reveals the effect.
    confused_with : mapping
        Effects that produce a similar torque → when, and how to separate them.
    typical : str
        Typical sizes.
    references : tuple of str
    """

    name: ClassVar[str]
    formula: str
    coefficients: tuple[Coefficient, ...]
    shapes: tuple[Shape, ...] = ()
    states: tuple[MemoryState, ...] = ()
    signals: tuple[str, ...] = ("dq",)
    joints: tuple[int, ...] = ()
    dry: bool = False
    couples: ClassVar[bool] = False
    whole_arm: bool = False
    per_recording: ClassVar[bool] = False
    commanded: ClassVar[bool] = False
    on_torque_signal: ClassVar[bool] = False
    like_uncertain_friction: ClassVar[tuple[str, ...]] = ()
    energy: ClassVar[str | None] = None
    option: str = ""
    options: ClassVar[Mapping[str, str]] = {}
    free_options: ClassVar[bool] = False
    orthonormal: ClassVar[bool] = False
    replaces: tuple[str, ...] = ()
    accompanied_by: tuple[str, ...] = ()
    counted_as: tuple[str, ...] = ()
    candidate: ClassVar[bool] = True
    unless_measured: ClassVar[str] = ""
    finding: ClassVar[tuple[str, ...]] = ()
    change: ClassVar[tuple[str, ...]] = ()
    size_unit: ClassVar[str] = ""
    revealed_by: ClassVar[str] = ""
    confused_with: ClassVar[Mapping[str, str]] = {}
    typical: ClassVar[str] = ""
    references: ClassVar[tuple[str, ...]] = ()

    def __init__(self, *, option: str = "") -> None:
        if option and option not in self.options:
            known = ", ".join(self.options) or "no option"
            raise EffectError(f"{self.name} has no option {option!r}; expected {known}")
        self.option = option

    @abstractmethod
    def columns(self, s: Signals, shape: ShapeSymbols) -> Columns:
        """Return one expression per linear coefficient."""

    def advance(self, before: Signals, now: Signals, shape: ShapeSymbols) -> Columns:
        """Return the states at the sample ``now``, one expression per state.

        ``before`` are the signals of the sample before, with the states there in
        ``before.state``; ``now`` is at any time after it. ``shape`` has shapes by name.
        """
        raise NotImplementedError(f"effect {self.name} has states but no advance")

    def next_states(self, before: Signals, now: Signals, shape: ShapeSymbols) -> list[ca.SX]:
        """See `advance`; states are held where one of its inputs is not finite.

        One NaN must not destroy the states of all samples after it; they evolve again from the next
        pair of finite samples. ``before``, ``now`` and ``shape`` are those of `advance`.
        """
        after = [ca.SX(x) for x in self.advance(before, now, shape)]
        size = ca.SX(0)
        for symbol in ca.symvar(ca.vertcat(*after)):
            size += ca.fabs(symbol)
        finite = size <= sys.float_info.max  # false for NaN
        return [
            ca.if_else(finite, x, before.state[state.name])
            for x, state in zip(after, self.states, strict=True)
        ]

    def state_rates(self, s: Signals, shape: ShapeSymbols) -> Columns:
        """Return the time derivatives of the states in continuous time; ``s`` has the states."""
        raise NotImplementedError(f"effect {self.name} has states but no state_rates")

    def size_text(self, parameters: Mapping[str, float]) -> str:
        """Return parameters, by name, in an engineer's terms; empty to state them as they are."""
        return ""

    @property
    def label(self) -> str:
        """Name with its option, as written on the command line: ``stribeck/two_width``."""
        return f"{self.name}/{self.option}" if self.option else self.name

    def __repr__(self) -> str:
        return f"<effect {self.label}: {self.formula}>"
