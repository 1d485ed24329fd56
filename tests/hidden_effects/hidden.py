"""The effects that are hidden: random in place, shape and sign, with one strength to scale.

They are the plant's own; nothing comes from the package's effects. Limits keep sizes within what
a real arm might have, so that a strong effect is one that happens.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from lieid_casadi import plant
from lieid_casadi.plant import Arm, HiddenEffect, Thermal

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Ground:
    """What sizes are taken from: the arm and its motion before anything is hidden, (n,) each."""

    arm: Arm
    torque: Array  # what the drives can deliver
    speed: Array  # largest on the motion
    rms_speed: Array
    load: Array  # largest rigid torque on the motion
    lower: Array  # least angle on the motion
    upper: Array
    duration: float
    rate: float
    thermal: tuple[Thermal, Thermal]
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
        """Most that a joint is away from 25 °C."""
        return max(abs(t.start - 25.0) + t.rise for t in self.thermal)


@dataclass(frozen=True, eq=False)
class Hidden:
    """One hidden effect.

    Attributes
    ----------
    effect, joints
        Name and joints (from 0) as a diagnosis should give them.
    hide
        Arm, strength, run (0 or 1: training and test, or before and after) → arm with it.
    most, least
        Largest plausible strength, and the smallest that a recording resolves. Where both are
        the same, the noise is made to fit the strength.
    signals
        Of effects that no library has: what the unexplained part depends on.
    simulated
        Whether it works under a controller (not where it needs the whole path).
    elastic
        Whether it needs a smooth motion of the links, exactly tracked.
    """

    effect: str
    joints: tuple[int, ...]
    hide: Callable[[Arm, float, int], Arm]
    most: float
    signals: tuple[str, ...] = ()
    simulated: bool = True
    details: str = ""
    least: float = 0.0
    elastic: bool = False

    @property
    def fixed(self) -> bool:
        """Whether the strength is given, and the noise is to fit it."""
        return self.least == self.most


Maker = Callable[[Ground, int], Hidden | None]


def with_effect(make: Callable[[float], HiddenEffect]) -> Callable[[Arm, float, int], Arm]:
    """Return a ``hide`` that adds the effect made with a strength."""
    return lambda arm, strength, run: arm.with_effects(make(strength))


def _one(
    name: str,
    joint: int,
    most: float,
    make: Callable[[float], HiddenEffect],
    details: str = "",
    least: float = 0.0,
) -> Hidden:
    return Hidden(name, (joint,), with_effect(make), most, details=details, least=least)


def _viscous_polynomial(g: Ground, j: int) -> Hidden:
    a, b = [(1.0, 0.0), (0.0, 1.0), (1.0, 0.6), (0.6, 1.0)][int(g.random.integers(4))]
    sign, v = g.sign(), float(g.speed[j])
    a, b = sign * a, -sign * b
    return _one(
        "viscous_polynomial", j, 0.25 * g.torque[j],
        lambda s: plant.ViscousPolynomial(j, quadratic=s * a / v**2, cubic=s * b / v**3),
        f"quadratic {a:g}, cubic {b:g} at full speed",
    )  # fmt: skip


def _viscous_asymmetric(g: Ground, j: int) -> Hidden:
    f = g.sign() / float(g.speed[j])
    return _one(
        "viscous_asymmetric", j, 0.15 * g.torque[j],
        lambda s: plant.ViscousAsymmetric(j, coefficient=f * s),
    )  # fmt: skip


def _stribeck(g: Ground, j: int) -> Hidden:
    v = g.log(0.02, 0.25) * float(g.speed[j])
    most = 2.0 * g.arm.friction.coulomb[j] + 0.05 * g.torque[j]
    return _one(
        "stribeck", j, most, lambda s: plant.Stribeck(j, extra=s, velocity=v), f"v_s = {v:.3g}"
    )


def _load_friction(g: Ground, j: int) -> Hidden:
    return _one("load_friction", j, 0.4, lambda s: plant.LoadFriction(j, gain=s))


def _temperature_friction(g: Ground, j: int) -> Hidden:
    a, b = [(1.0, 0.0), (0.0, 1.0), (1.0, 0.4), (0.5, 1.0)][int(g.random.integers(4))]
    return _one(
        "temperature_friction", j, 0.8 / g.warmest(),
        lambda s: plant.TemperatureFriction(j, viscous_decay=a * s, dry_slope=b * s),
        f"viscous {a:g}, dry {b:g}",
    )  # fmt: skip


def _warm_up(g: Ground, j: int) -> Hidden:
    theta = g.log(0.15, 0.7) * g.duration
    return _one(
        "warm_up", j, 0.8, lambda s: plant.WarmUp(j, change=-s, time_constant=theta),
        f"time constant {theta:.3g} s",
    )  # fmt: skip


def _position_friction(g: Ground, j: int) -> Hidden | None:
    if not g.revolute(j):
        return None
    k, phase = float(g.random.integers(1, 5)), g.angle()
    return _one(
        "position_friction", j, 0.9 * g.arm.friction.coulomb[j],
        lambda s: plant.PositionFriction(j, amplitude=s, harmonic=k, phase=phase), f"k = {k:g}",
    )  # fmt: skip


def _presliding(g: Ground, j: int) -> Hidden:
    # What is left depends little on the width: it is drawn, and the noise follows.
    width = g.log(0.005, 0.15) * (1.0 if g.revolute(j) else 0.3)
    return Hidden(
        "presliding", (j,), with_effect(lambda s: plant.Presliding(j, width=s)), width, least=width,
        details=f"width {width:.3g}",
    )  # fmt: skip


def _armature(g: Ground, j: int) -> Hidden:
    return _one("armature", j, 0.06 * g.torque[j], lambda s: plant.Armature(j, inertia=s))


def _joint_elasticity(g: Ground, j: int) -> Hidden | None:
    if not g.revolute(j):
        return None
    most = 0.1 / max(float(g.load[j]), 1e-6)
    return Hidden(
        "joint_elasticity", (j,),
        with_effect(lambda s: plant.JointElasticity(j, stiffness=1.0 / s)), most, elastic=True,
    )  # fmt: skip


def _torque_ripple(g: Ground, j: int) -> Hidden | None:
    if not g.revolute(j):
        return None
    highest = 2.0 * np.pi * g.rate / 6.0 / float(g.rms_speed[j])
    k, phase = float(round(g.log(2.0, min(highest, 120.0)))), g.angle()
    return _one(
        "torque_ripple", j, 0.15 * g.torque[j],
        lambda s: plant.TorqueRipple(j, amplitude=s, harmonic=k, phase=phase), f"k = {k:g}",
    )  # fmt: skip


def _position_spring(g: Ground, j: int) -> Hidden:
    rest = float(g.random.uniform(g.lower[j], g.upper[j]))
    most = 0.3 * g.torque[j] / max(float(g.upper[j] - g.lower[j]), 1e-3)
    return _one(
        "position_spring", j, most, lambda s: plant.PositionSpring(j, stiffness=s, rest=rest)
    )


def _position_spring_after(g: Ground, j: int) -> Hidden:
    """K·q: where the model is kept, a rest angle elsewhere would change the offset too."""
    most = 0.3 * g.torque[j] / max(float(g.upper[j] - g.lower[j]), 1e-3)
    return _one("position_spring", j, most, lambda s: plant.PositionSpring(j, stiffness=s))


def _transmission_coupling(g: Ground, j: int) -> Hidden:
    i = int(g.random.choice([k for k in range(g.n) if k != j]))
    a, b = [(1.0, 0.0), (0.0, 1.0), (1.0, 0.5), (0.5, 1.0)][int(g.random.integers(4))]
    a, b = g.sign() * a / float(g.speed[i]), g.sign() * b
    return Hidden(
        "transmission_coupling", (j, i),
        with_effect(
            lambda s: plant.TransmissionCoupling(
                j, source=i, viscous_coefficient=s * a, coulomb=s * b
            )
        ),
        0.15 * g.torque[j], details=f"viscous {a * g.speed[i]:g} at full speed, dry {b:g}",
    )  # fmt: skip


def _torque_gain(g: Ground, j: int) -> Hidden:
    sign = g.sign()
    return _one("torque_gain", j, 0.4, lambda s: plant.TorqueGain(j, gain=sign * s))


def _torque_delay(g: Ground, j: int) -> Hidden:
    least = 0.3 / g.rate
    return _one("torque_delay", j, 0.08, lambda s: plant.TorqueDelay(j, delay=s), least=least)


def _bias_drift(g: Ground, j: int) -> Hidden:
    rates = g.sign() / g.duration, float(g.random.uniform(-1.0, 1.0)) / g.duration
    return Hidden(
        "bias_drift", (j,),
        # where it counts: the training run, or the run after
        lambda arm, s, run: arm.with_effects(plant.BiasDrift(j, rate=s * rates[run])),
        0.2 * g.torque[j],
    )  # fmt: skip


def _bias_drift_after(g: Ground, j: int) -> Hidden:
    rate = g.sign() / g.duration
    return _one("bias_drift", j, 0.2 * g.torque[j], lambda s: plant.BiasDrift(j, rate=s * rate))


def _encoder_offset(g: Ground, j: int) -> Hidden:
    sign, most = g.sign(), 0.2 if g.revolute(j) else 0.05
    return _one("encoder_offset", j, most, lambda s: plant.EncoderOffset(j, offset=sign * s))


def _base_tilt(g: Ground, j: int) -> Hidden:
    x, y = g.direction(2)
    return Hidden(
        "base_tilt", (),
        with_effect(lambda s: plant.BaseTilt(about_x=float(s * x), about_y=float(s * y))), 0.2,
    )  # fmt: skip


def _external_wrench(g: Ground, j: int) -> Hidden:
    force, moment = g.direction(3), 0.2 * g.direction(3)
    weight = 9.81 * float(g.arm.parameters[::10].sum())
    return Hidden(
        "external_wrench", (),
        with_effect(
            lambda s: plant.ExternalWrench(
                moment=tuple(map(float, s * moment)), force=tuple(map(float, s * force))
            )
        ),
        0.3 * weight,
    )  # fmt: skip


def _payload(g: Ground, j: int) -> Hidden:
    com = tuple(map(float, g.random.uniform(0.0, 0.1) * g.direction(3)))
    weight = float(g.arm.parameters[::10].sum())
    return Hidden(
        "payload", (), with_effect(lambda s: plant.Payload(mass=s, com=com)), 0.4 * weight
    )


def _plain_friction(name: str) -> Maker:
    def make(g: Ground, j: int) -> Hidden:
        sign = g.sign()
        now = float(getattr(g.arm.friction, name)[j])
        most = 0.8 * now if name != "offset" and sign < 0.0 else 0.15 * float(g.torque[j])

        def hide(arm: Arm, strength: float, run: int) -> Arm:
            values = getattr(arm.friction, name).copy()
            values[j] += sign * strength
            return replace(arm, friction=replace(arm.friction, **{name: values}))

        if name == "viscous" and sign > 0.0:
            most /= float(g.speed[j])
        return Hidden(name, (j,), hide, most, details="more" if sign > 0.0 else "less")

    return make


MISSING: dict[str, Maker] = {
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
    "bias_drift": _bias_drift,
    "encoder_offset": _encoder_offset,
    "base_tilt": _base_tilt,
    "external_wrench": _external_wrench,
}

CHANGED: dict[str, Maker] = {
    name: make for name, make in MISSING.items() if name not in ("armature", "bias_drift")
} | {
    "bias_drift": _bias_drift_after,
    "position_spring": _position_spring_after,
    "payload": _payload,
    "coulomb": _plain_friction("coulomb"),
    "viscous": _plain_friction("viscous"),
    "offset": _plain_friction("offset"),
}
