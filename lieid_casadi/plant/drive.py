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
        self._levels = _defining(effects, "level")
        self._slopes = _defining(effects, "level_slope")
        self._level_scales = _defining(effects, "level_scale")
        self._viscous = _defining(effects, "viscous")
        self._viscous_scales = _defining(effects, "viscous_scale")
        self._torques = _defining(effects, "torque")
        self.hysteresis_width = np.zeros(arm.n)
        for effect in arm.effects:
            if isinstance(effect, Presliding):
                self.hysteresis_width[effect.joint] = effect.width
        self.hysteretic = self.hysteresis_width > 0.0

    def level(self, s: JointState) -> Array:
        """Level of dry friction (…, n) ≥ 0, N·m."""
        if not self._levels and not self._level_scales:
            return np.broadcast_to(self._friction.coulomb, s.dq.shape)
        level = np.broadcast_to(self._friction.coulomb, s.dq.shape).copy()
        for effect in self._levels:
            level[..., effect.joint] += effect.level(s)
        for effect in self._level_scales:
            level[..., effect.joint] *= effect.level_scale(s)
        return np.maximum(level, 0.0)

    def level_slope(self, s: JointState) -> Array | None:
        """Derivative of the level by the load (…, n); None if it is zero everywhere."""
        if not self._slopes:
            return None
        slope = np.zeros(s.dq.shape)
        for effect in self._slopes:
            slope[..., effect.joint] += effect.level_slope(s)
        for effect in self._level_scales:
            slope[..., effect.joint] *= effect.level_scale(s)
        return slope

    def damping(self, s: JointState) -> Array:
        """Linear viscous coefficient (…, n), N·m·s/rad."""
        if not self._viscous_scales:
            return self._friction.viscous
        damping = np.broadcast_to(self._friction.viscous, s.dq.shape).copy()
        for effect in self._viscous_scales:
            damping[..., effect.joint] *= effect.viscous_scale(s)
        return damping

    def smooth(self, s: JointState) -> Array:
        """All torques except those of the rigid arm, armature and dry friction (…, n), N·m."""
        friction = self._friction.viscous * s.dq
        for effect in self._viscous:
            friction[..., effect.joint] += effect.viscous(s)
        for effect in self._viscous_scales:
            friction[..., effect.joint] *= effect.viscous_scale(s)
        torque = friction + self._friction.offset
        for effect in self._torques:
            torque[..., effect.joint] += effect.torque(s)
        return torque

    def next_hysteresis(self, z: Array, step: Array) -> Array:
        """Dahl's state (n,), −1…1, after the motor moved by ``step`` (n,); exact for any step."""
        direction = np.sign(step)
        left = np.exp(-np.abs(step) / np.where(self.hysteretic, self.hysteresis_width, 1.0))
        return np.where(self.hysteretic, direction + (z - direction) * left, 0.0)


def _defining(effects: list[JointEffect], *methods: str) -> list[JointEffect]:
    return [
        effect
        for effect in effects
        if any(getattr(type(effect), name) is not getattr(JointEffect, name) for name in methods)
    ]
