"""Torques of the drives besides those of the rigid arm: friction and hidden effects."""

from __future__ import annotations

import numpy as np

from lieid_casadi.arrays import Array
from lieid_casadi.plant.arm import Arm
from lieid_casadi.plant.effects import JointEffect, JointState, Presliding


class Drive:
    """Friction and effects of an arm, prepared for many evaluations.

    Arrays are (n,) at one instant or (N, n) along a path. Only effects that define a term are
    evaluated for it.
    """

    def __init__(self, arm: Arm) -> None:
        effects = [e for e in arm.effects if isinstance(e, JointEffect)]
        self._friction = arm.friction
        terms = ("level", "level_slope", "level_scale", "viscous", "viscous_scale", "torque")
        self._defining = {term: [e for e in effects if hasattr(e, term)] for term in terms}
        self.hysteresis_width = np.zeros(arm.n)
        for effect in arm.effects_of(Presliding):
            self.hysteresis_width[effect.joint] = effect.width
        self.hysteretic = self.hysteresis_width > 0.0

    def _with(self, values: Array, s: JointState, term: str, scale: str = "") -> Array:
        """Return values (…, n) with what effects add to their joints, times their scales."""
        found = np.broadcast_to(values, s.dq.shape).copy()
        for effect in self._defining[term] if term else ():
            found[..., effect.joint] += getattr(effect, term)(s)
        for effect in self._defining[scale] if scale else ():
            found[..., effect.joint] *= getattr(effect, scale)(s)
        return found

    def level(self, s: JointState) -> Array:
        """Level of dry friction (…, n) ≥ 0, N·m."""
        return np.maximum(self._with(self._friction.coulomb, s, "level", "level_scale"), 0.0)

    def level_slope(self, s: JointState) -> Array | None:
        """Derivative of the level by the load (…, n); None if it is zero everywhere."""
        if not self._defining["level_slope"]:
            return None
        return self._with(np.zeros(()), s, "level_slope", "level_scale")

    def damping(self, s: JointState) -> Array:
        """Linear viscous coefficient (…, n), N·m·s/rad."""
        return self._with(self._friction.viscous, s, "", "viscous_scale")

    def smooth(self, s: JointState) -> Array:
        """All torques except those of the rigid arm, armature and dry friction (…, n), N·m."""
        friction = self._with(self._friction.viscous * s.dq, s, "viscous", "viscous_scale")
        return self._with(friction + self._friction.offset, s, "torque")

    def next_hysteresis(self, z: Array, step: Array) -> Array:
        """Dahl's state (n,), −1…1, after the motor moved by ``step`` (n,); exact for any step."""
        direction = np.sign(step)
        left = np.exp(-np.abs(step) / np.where(self.hysteretic, self.hysteresis_width, 1.0))
        return np.where(self.hysteretic, direction + (z - direction) * left, 0.0)
