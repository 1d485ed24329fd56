"""The effects to hide: random joint, shape and sign, with one strength to scale.

They are defined by the simulated arm, independently of the package's effects. Limits keep
strengths within those of real arms.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from lieid_casadi import plant
from lieid_casadi.arrays import Array
from lieid_casadi.plant import Arm, HiddenEffect, Thermal


@dataclass(frozen=True, eq=False)
class ReferenceMotion:
    """The arm without hidden effects and its motion, from which limits are derived; (n,) arrays."""

    arm: Arm
    torque: Array  # that the drives can deliver, N·m
    speed: Array  # largest on the motion
    rms_speed: Array
    load: Array  # largest rigid torque on the motion
    lower: Array  # least angle on the motion
    upper: Array
    duration: float
    rate: float
    thermal: tuple[Thermal, ...]
    random: np.random.Generator

    @property
    def n(self) -> int:
        return self.arm.n

    def sign(self) -> float:
        return float(self.random.choice([-1.0, 1.0]))

    def angle(self) -> float:
        return float(self.random.uniform(-np.pi, np.pi))

    def log(self, lower: float, upper: float) -> float:
        return float(np.exp(self.random.uniform(np.log(lower), np.log(upper))))

    def revolute(self, joint: int) -> bool:
        return self.arm.robot.joints[joint].revolute

    def direction(self, size: int) -> Array:
        v = self.random.standard_normal(size)
        return v / np.linalg.norm(v)

    def warmest(self) -> float:
        """Return the largest deviation of a joint temperature from 25 °C."""
        return max(abs(t.start - 25.0) + t.rise for t in self.thermal)


@dataclass(frozen=True, eq=False)
class ScalableEffect:
    """One hidden effect; name and joints (from 0) are those that a diagnosis should give.

    ``hide`` takes the arm, a strength and the run (0 or 1: training and test, or before and after).
    Strengths are between the smallest that a recording resolves and the largest realistic one; if
    both are equal, the noise is scaled instead.
    """

    effect: str
    joints: tuple[int, ...]
    hide: Callable[[Arm, float, int], Arm]
    most: float
    signals: tuple[str, ...] = ()  # that an effect outside the library depends on; a|b: either
    simulated: bool = True  # with a controller; not if it needs the whole path
    details: str = ""
    least: float = 0.0
    elastic: bool = False  # needs a smooth motion of the links that is tracked exactly
    accepted: tuple[str, ...] = ()  # effects of the class of a form, any of which is right

    @property
    def fixed(self) -> bool:
        """Whether the strength is given and the noise is scaled."""
        return self.least == self.most


EffectFactory = Callable[[ReferenceMotion, int], ScalableEffect | None]


def with_effect(make: Callable[[float], HiddenEffect]) -> Callable[[Arm, float, int], Arm]:
    """Return a ``hide`` that adds the effect made with a strength."""
    return lambda arm, strength, run: arm.with_effects(make(strength))


MOST_RUNS = 4  # recordings of a case


def _one(
    name: str,
    joint: int,
    most: float,
    make: Callable[[float], HiddenEffect],
    details: str = "",
    least: float = 0.0,
) -> ScalableEffect:
    return ScalableEffect(name, (joint,), with_effect(make), most, details=details, least=least)


def _viscous_polynomial(g: ReferenceMotion, j: int) -> ScalableEffect:
    a, b = [(1.0, 0.0), (0.0, 1.0), (1.0, 0.6), (0.6, 1.0)][int(g.random.integers(4))]
    sign, v = g.sign(), float(g.speed[j])
    a, b = sign * a, -sign * b
    return _one(
        "viscous_polynomial", j, 0.25 * g.torque[j],
        lambda s: plant.ViscousPolynomial(j, quadratic=s * a / v**2, cubic=s * b / v**3),
        f"quadratic {a:g}, cubic {b:g} at full speed",
    )  # fmt: skip


def _viscous_asymmetric(g: ReferenceMotion, j: int) -> ScalableEffect:
    f = g.sign() / float(g.speed[j])
    return _one(
        "viscous_asymmetric", j, 0.15 * g.torque[j],
        lambda s: plant.ViscousAsymmetric(j, coefficient=f * s),
    )  # fmt: skip


def _stribeck(g: ReferenceMotion, j: int) -> ScalableEffect:
    v = g.log(0.02, 0.25) * float(g.speed[j])
    most = 2.0 * g.arm.friction.coulomb[j] + 0.05 * g.torque[j]
    return _one(
        "stribeck", j, most, lambda s: plant.Stribeck(j, extra=s, velocity=v), f"v_s = {v:.3g}"
    )


def _load_friction(g: ReferenceMotion, j: int) -> ScalableEffect:
    return _one("load_friction", j, 0.4, lambda s: plant.LoadFriction(j, gain=s))


def _temperature_friction(g: ReferenceMotion, j: int) -> ScalableEffect:
    a, b = [(1.0, 0.0), (0.0, 1.0), (1.0, 0.4), (0.5, 1.0)][int(g.random.integers(4))]
    return _one(
        "temperature_friction", j, 0.8 / g.warmest(),
        lambda s: plant.TemperatureFriction(j, viscous_decay=a * s, dry_slope=b * s),
        f"viscous {a:g}, dry {b:g}",
    )  # fmt: skip


def _warm_up(g: ReferenceMotion, j: int) -> ScalableEffect:
    theta = g.log(0.15, 0.7) * g.duration
    return _one(
        "warm_up", j, 0.8, lambda s: plant.WarmUp(j, change=-s, time_constant=theta),
        f"time constant {theta:.3g} s",
    )  # fmt: skip


def _position_friction(g: ReferenceMotion, j: int) -> ScalableEffect | None:
    if not g.revolute(j):
        return None
    k, phase = float(g.random.integers(1, 5)), g.angle()
    return _one(
        "position_friction", j, 0.9 * g.arm.friction.coulomb[j],
        lambda s: plant.PositionFriction(j, amplitude=s, harmonic=k, phase=phase), f"k = {k:g}",
    )  # fmt: skip


def _presliding(g: ReferenceMotion, j: int) -> ScalableEffect:
    # the unexplained part depends little on the width: it is drawn, and the noise is scaled
    width = g.log(0.005, 0.15) * (1.0 if g.revolute(j) else 0.3)
    return ScalableEffect(
        "presliding", (j,), with_effect(lambda s: plant.Presliding(j, width=s)), width, least=width,
        details=f"width {width:.3g}",
    )  # fmt: skip


def _armature(g: ReferenceMotion, j: int) -> ScalableEffect:
    return _one("armature", j, 0.06 * g.torque[j], lambda s: plant.Armature(j, inertia=s))


def _joint_elasticity(g: ReferenceMotion, j: int) -> ScalableEffect | None:
    if not g.revolute(j):
        return None
    most = 0.1 / max(float(g.load[j]), 1e-6)
    return ScalableEffect(
        "joint_elasticity", (j,),
        with_effect(lambda s: plant.JointElasticity(j, stiffness=1.0 / s)), most, elastic=True,
    )  # fmt: skip


def _torque_ripple(g: ReferenceMotion, j: int) -> ScalableEffect | None:
    if not g.revolute(j):
        return None
    highest = 2.0 * np.pi * g.rate / 6.0 / float(g.rms_speed[j])
    k, phase = float(round(g.log(2.0, min(highest, 120.0)))), g.angle()
    return _one(
        "torque_ripple", j, 0.15 * g.torque[j],
        lambda s: plant.TorqueRipple(j, amplitude=s, harmonic=k, phase=phase), f"k = {k:g}",
    )  # fmt: skip


def _position_spring(g: ReferenceMotion, j: int) -> ScalableEffect:
    rest = float(g.random.uniform(g.lower[j], g.upper[j]))
    most = 0.3 * g.torque[j] / max(float(g.upper[j] - g.lower[j]), 1e-3)
    return _one(
        "position_spring", j, most, lambda s: plant.PositionSpring(j, stiffness=s, rest=rest)
    )


def _position_spring_after(g: ReferenceMotion, j: int) -> ScalableEffect:
    """Return K·q: with the model kept, another rest angle would also change the offset."""
    most = 0.3 * g.torque[j] / max(float(g.upper[j] - g.lower[j]), 1e-3)
    return _one("position_spring", j, most, lambda s: plant.PositionSpring(j, stiffness=s))


def _transmission_coupling(g: ReferenceMotion, j: int) -> ScalableEffect:
    i = int(g.random.choice([k for k in range(g.n) if k != j]))
    a, b = [(1.0, 0.0), (0.0, 1.0), (1.0, 0.5), (0.5, 1.0)][int(g.random.integers(4))]
    a, b = g.sign() * a / float(g.speed[i]), g.sign() * b
    return ScalableEffect(
        "transmission_coupling", (j, i),
        with_effect(
            lambda s: plant.TransmissionCoupling(
                j, source=i, viscous_coefficient=s * a, coulomb=s * b
            )
        ),
        0.15 * g.torque[j], details=f"viscous {a * g.speed[i]:g} at full speed, dry {b:g}",
    )  # fmt: skip


def _torque_gain(g: ReferenceMotion, j: int) -> ScalableEffect:
    sign = g.sign()
    return _one("torque_gain", j, 0.4, lambda s: plant.TorqueGain(j, gain=sign * s))


def _torque_delay(g: ReferenceMotion, j: int) -> ScalableEffect:
    least = 0.3 / g.rate
    return _one("torque_delay", j, 0.08, lambda s: plant.TorqueDelay(j, delay=s), least=least)


def _torque_lowpass(g: ReferenceMotion, j: int) -> ScalableEffect:
    least = 0.3 / g.rate
    return _one(
        "torque_lowpass", j, 0.08, lambda s: plant.TorqueLowpass(j, time_constant=s), least=least
    )


def _time_shift(g: ReferenceMotion, j: int) -> ScalableEffect:
    least = 0.3 / g.rate
    return ScalableEffect(
        "time_shift", (), with_effect(lambda s: plant.TimeShift(delay=s)), 0.08, least=least
    )


def _bias_drift(g: ReferenceMotion, j: int) -> ScalableEffect:
    rates = np.array([g.sign(), *g.random.uniform(-1.0, 1.0, MOST_RUNS - 1)]) / g.duration
    return ScalableEffect(
        "bias_drift", (j,),
        # of another rate in every recording
        lambda arm, s, run: arm.with_effects(plant.BiasDrift(j, rate=s * rates[run])),
        0.2 * g.torque[j],
    )  # fmt: skip


def _bias_drift_after(g: ReferenceMotion, j: int) -> ScalableEffect:
    rate = g.sign() / g.duration
    return _one("bias_drift", j, 0.2 * g.torque[j], lambda s: plant.BiasDrift(j, rate=s * rate))


def _encoder_offset(g: ReferenceMotion, j: int) -> ScalableEffect:
    sign, most = g.sign(), 0.2 if g.revolute(j) else 0.05
    return _one("encoder_offset", j, most, lambda s: plant.EncoderOffset(j, offset=sign * s))


def _base_tilt(g: ReferenceMotion, j: int) -> ScalableEffect:
    x, y = g.direction(2)
    return ScalableEffect(
        "base_tilt", (),
        with_effect(lambda s: plant.BaseTilt(about_x=float(s * x), about_y=float(s * y))), 0.2,
    )  # fmt: skip


def _external_wrench(g: ReferenceMotion, j: int) -> ScalableEffect:
    force, moment = g.direction(3), 0.2 * g.direction(3)
    weight = 9.81 * float(g.arm.parameters[::10].sum())
    return ScalableEffect(
        "external_wrench", (),
        with_effect(
            lambda s: plant.ExternalWrench(
                moment=tuple(map(float, s * moment)), force=tuple(map(float, s * force))
            )
        ),
        0.3 * weight,
    )  # fmt: skip


def _payload(g: ReferenceMotion, j: int) -> ScalableEffect:
    com = tuple(map(float, g.random.uniform(0.0, 0.1) * g.direction(3)))
    weight = float(g.arm.parameters[::10].sum())
    return ScalableEffect(
        "payload", (), with_effect(lambda s: plant.Payload(mass=s, com=com)), 0.4 * weight
    )


def _plain_friction(name: str) -> EffectFactory:
    def make(g: ReferenceMotion, j: int) -> ScalableEffect:
        sign = g.sign()
        now = float(getattr(g.arm.friction, name)[j])
        most = 0.8 * now if name != "offset" and sign < 0.0 else 0.15 * float(g.torque[j])

        def hide(arm: Arm, strength: float, run: int) -> Arm:
            values = getattr(arm.friction, name).copy()
            values[j] += sign * strength
            return replace(arm, friction=replace(arm.friction, **{name: values}))

        if name == "viscous" and sign > 0.0:
            most /= float(g.speed[j])
        return ScalableEffect(name, (j,), hide, most, details="more" if sign > 0.0 else "less")

    return make


MISSING: dict[str, EffectFactory] = {
    "viscous_polynomial": _viscous_polynomial,
    "viscous_asymmetric": _viscous_asymmetric,
    "stribeck": _stribeck,
    "load_friction": _load_friction,
    "temperature_friction": _temperature_friction,
    "warm_up": _warm_up,
    "position_friction": _position_friction,
    "presliding": _presliding,
    "armature": _armature,
    "joint_elasticity": _joint_elasticity,
    "torque_ripple": _torque_ripple,
    "position_spring": _position_spring,
    "transmission_coupling": _transmission_coupling,
    "torque_gain": _torque_gain,
    "torque_delay": _torque_delay,
    "torque_lowpass": _torque_lowpass,
    "time_shift": _time_shift,
    "bias_drift": _bias_drift,
    "encoder_offset": _encoder_offset,
    "base_tilt": _base_tilt,
    "external_wrench": _external_wrench,
}

CHANGED: dict[str, EffectFactory] = {
    name: make for name, make in MISSING.items() if name not in ("armature", "bias_drift")
} | {
    "bias_drift": _bias_drift_after,
    "position_spring": _position_spring_after,
    "payload": _payload,
    "coulomb": _plain_friction("coulomb"),
    "viscous": _plain_friction("viscous"),
    "offset": _plain_friction("offset"),
}
