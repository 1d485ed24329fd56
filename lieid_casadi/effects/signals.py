"""The signals that effects depend on, as symbols."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Protocol

import casadi as ca


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
    other
        Signals of the joint that acts on this one, for couplings.
    state
        The effect's own states at this sample, by name.
    command_error
        Commanded minus measured position, rad; zero where there are no commands.
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
    other: Signals | None = None
    state: Mapping[str, ca.SX] = field(default_factory=dict)
    command_error: ca.SX = field(default_factory=lambda: ca.SX(0))
    every: SignalsOfJoints | None = None

    def joint(self, number: int) -> Signals:
        """Return the signals of another joint (from 0), one of `Effect.joints`."""
        assert self.every is not None
        return self.every.of(number)


@dataclass(frozen=True)
class EffectSignals:
    """The signals of all joints (n,), of which `of` selects those of one.

    ``command_error`` is None where there are no commands.
    """

    q: ca.SX
    dq: ca.SX
    ddq: ca.SX
    sign: ca.SX
    load: ca.SX
    temperature: ca.SX
    time: ca.SX
    command_error: ca.SX | None = None

    def of(
        self, joint: int, source: int | None = None, state: Mapping[str, ca.SX] | None = None
    ) -> Signals:
        """Return the signals of one joint.

        Parameters
        ----------
        joint : int
            From 0.
        source : int, optional
            The joint that acts on it, for couplings.
        state : mapping, optional
            The effect's own states by name.
        """
        return Signals(
            q=self.q[joint],
            dq=self.dq[joint],
            ddq=self.ddq[joint],
            sign=self.sign[joint],
            load=self.load[joint],
            temperature=self.temperature[joint],
            time=self.time,
            other=None if source is None else self.of(source),
            state=state or {},
            command_error=ca.SX(0) if self.command_error is None else self.command_error[joint],
            every=self,
        )
