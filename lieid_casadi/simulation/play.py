"""Coordinates of an arm whose motors move apart from their links within a play."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from lieid_casadi.arrays import Array
from lieid_casadi.effects.backlash import Backlash, motor_in_play
from lieid_casadi.identification.fit import Fit
from lieid_casadi.identification.regression.segment_columns import model_along
from lieid_casadi.recording import Processed

LARGEST = Backlash.coefficients[0].limit  # rad


@dataclass(frozen=True)
class Play:
    """Play of one joint (from 0), rad."""

    joint: int
    width: float


def plays_of(fit: Fit) -> tuple[Play, ...]:
    """Return the plays of a fit, of joints whose motor has an inertia of its own (armature).

    Without one, nothing defines how a motor moves apart from its link. A play above the limit of
    the effect is that of a recording in which the load keeps its sign, and is left out.
    """
    found = {(c.name, c.joint): float(v) for c, v in zip(
        fit.model.columns, fit.effect_coefficients, strict=True
    )}  # fmt: skip
    plays = (
        Play(p.joint, found[f"{Backlash.name}.b", p.joint])
        for p in fit.model.placements
        if isinstance(p.effect, Backlash)
    )
    return tuple(
        play
        for play in plays
        if 0.0 < play.width <= LARGEST and found.get(("armature.I_a", play.joint), 0.0) > 0.0
    )


@dataclass(frozen=True, eq=False)
class Coordinates:
    """Coordinates (d): the angles of the motors (n), then those of the links with play (P)."""

    motors: Array  # (n, d) angles of the motors from the coordinates
    links: Array  # (n, d) the same of the links; equal on joints without play
    plays: tuple[Play, ...]

    @classmethod
    def of(cls, fit: Fit) -> Coordinates:
        """Return the coordinates of a fit."""
        n, plays = fit.model.n, plays_of(fit)
        motors = np.eye(n, n + len(plays))
        links = motors.copy()
        for k, play in enumerate(plays):
            links[play.joint] = 0.0
            links[play.joint, n + k] = 1.0
        return cls(motors, links, plays)

    @property
    def size(self) -> int:
        """Number of coordinates, d."""
        return len(self.motors.T)

    @property
    def twists(self) -> Array:
        """(P, d): angle of the motors minus that of their links, from the coordinates."""
        return (self.motors - self.links)[[play.joint for play in self.plays]]

    def along(self, fit: Fit, segment: Processed) -> tuple[Array, Array]:
        """Return coordinates (K, d) and velocities along a segment, whose motors are measured.

        The place of the links in their play is that of `lieid_casadi.effects.backlash`.
        """
        arm = model_along(fit.compiled, segment, fit.shapes, fit.parameters, fitted=False)
        q, dq = [segment.q], [segment.dq]
        for play in self.plays:
            place = motor_in_play(arm, play.joint, play.width)[:, None]
            q.append(segment.q[:, [play.joint]] - place)
            dq.append(segment.dq[:, [play.joint]] - np.gradient(place, segment.t, axis=0))
        return np.hstack(q), np.hstack(dq)
