"""Simulated arms with friction and hidden effects of realistic size, for any robot."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from lieid_casadi.errors import EffectError
from lieid_casadi.plant import effects
from lieid_casadi.plant.arm import Arm, JointFriction, Thermal, perturbed_inertias
from lieid_casadi.plant.effects import HiddenEffect
from lieid_casadi.plant.sensors import Sensors
from lieid_casadi.plant.trajectories import Envelope, torque_scale
from lieid_casadi.robot import Robot
from lieid_casadi.robot.pinocchio_model import build_pinocchio

TEMPERATURE_RISE = 12.0  # °C, of demo arms with a temperature effect


def demo_arm(
    robot: Robot,
    *,
    seed: int = 0,
    hidden: str | HiddenEffect | None = "load_friction",
    joint: int = 1,
    strength: float = 1.0,
) -> Arm:
    """Return the arm that ``lieid demo`` measures.

    Inertias differ from the nominal ones by up to 20 %. Every joint has Coulomb and viscous
    friction and an offset in proportion to its torque limit. One effect is hidden: ``hidden``, or
    the effect of this name (see `hidden_effect`) on ``joint`` (from 0) with a factor on its size.
    """
    random = np.random.default_rng([seed, 10])
    scale, speed = torque_scale(robot), Envelope.of(robot).velocity
    friction = JointFriction(
        coulomb=scale * random.uniform(0.025, 0.05, robot.n),
        viscous=scale / speed * random.uniform(0.02, 0.05, robot.n),
        offset=scale * random.uniform(-0.01, 0.01, robot.n),
    )
    arm = Arm(robot, perturbed_inertias(robot, seed=seed), friction)
    if not isinstance(hidden, str):
        return arm if hidden is None else arm.with_effects(hidden)
    effect = hidden_effect(arm, hidden, joint, strength=strength, seed=seed)
    if hidden == "temperature_friction":
        arm = replace(arm, thermal=Thermal(rise=TEMPERATURE_RISE, time_constant=20.0))
    return arm.with_effects(effect)


def demo_sensors(robot: Robot, *, rate: float = 200.0) -> Sensors:
    """Return typical sensors: 19-bit encoders, torque noise of 0.3 % of the limits."""
    scale = torque_scale(robot)
    return Sensors(
        rate=rate,
        counts_per_turn=2**19,
        counts_per_metre=1e6,
        velocity="difference",
        torque_noise=tuple(0.002 * scale),
        coloured_noise=tuple(0.002 * scale),
        torque_step=tuple(2e-4 * scale),
    )


def hidden_effect(
    arm: Arm, name: str, joint: int, *, strength: float = 1.0, seed: int = 0
) -> HiddenEffect:
    """Return an effect of `HIDDEN_EFFECT_NAMES` of realistic size times ``strength``.

    The joint is counted from 0; ``seed`` determines details (phase, harmonic, source).

    EffectError: unknown name.
    """
    if name not in _MAKERS:
        raise EffectError(f"hidden effect {name!r}; expected one of {', '.join(sorted(_MAKERS))}")
    return _MAKERS[name](_EffectSize(arm, joint, strength, np.random.default_rng([seed, 11])))


class _EffectSize:
    """Typical torque, speed and load of one joint, from which effects are sized."""

    def __init__(self, arm: Arm, joint: int, strength: float, random: np.random.Generator) -> None:
        self.arm, self.joint, self.strength, self.random = arm, joint, strength, random
        self.torque = strength * float(torque_scale(arm.robot)[joint])
        self.speed = float(Envelope.of(arm.robot).velocity[joint])
        self.coulomb = float(arm.friction.coulomb[joint])

    def angle(self) -> float:
        return float(self.random.uniform(-np.pi, np.pi))

    def sign(self) -> float:
        return float(self.random.choice([-1.0, 1.0]))

    def neighbour(self) -> int:
        """Return a joint to couple to: the next, or the previous one for the last joint."""
        n = self.arm.n
        if n < 2:
            raise EffectError("transmission coupling needs a robot of at least two joints")
        return self.joint + 1 if self.joint + 1 < n else self.joint - 1

    def inertia(self) -> float:
        """Mean nominal inertia at the joint, kg·m²."""
        import pinocchio as pin

        robot = self.arm.robot
        model = build_pinocchio(robot)
        middle = Envelope.of(robot).middle
        return float(pin.crba(model, model.createData(), middle)[self.joint, self.joint])

    def weight(self) -> float:
        """Weight of all links, N."""
        return float(self.arm.parameters[::10].sum() * max(np.linalg.norm(self.arm.gravity), 1.0))

    def three(self, size: float) -> tuple[float, float, float]:
        """A random vector of this size."""
        x, y, z = self.random.standard_normal(3)
        f = size / float(np.sqrt(x * x + y * y + z * z))
        return float(f * x), float(f * y), float(f * z)


_MAKERS: dict[str, Callable[[_EffectSize], HiddenEffect]] = {
    "viscous_polynomial": lambda s: effects.ViscousPolynomial(
        s.joint, quadratic=-0.04 * s.torque / s.speed**2, cubic=0.06 * s.torque / s.speed**3
    ),
    "viscous_asymmetric": lambda s: effects.ViscousAsymmetric(
        s.joint, coefficient=s.sign() * 0.02 * s.torque / s.speed
    ),
    "stribeck": lambda s: effects.Stribeck(s.joint, extra=0.04 * s.torque, velocity=0.1 * s.speed),
    "load_friction": lambda s: effects.LoadFriction(s.joint, gain=0.1 * s.strength),
    "temperature_friction": lambda s: effects.TemperatureFriction(
        s.joint, viscous_decay=0.04 * s.strength, dry_slope=0.01 * s.strength
    ),
    "warm_up": lambda s: effects.WarmUp(
        s.joint, change=-min(0.5 * s.strength, 0.9), time_constant=20.0
    ),
    "position_friction": lambda s: effects.PositionFriction(
        s.joint,
        amplitude=min(0.5 * s.strength, 0.95) * s.coulomb,
        harmonic=float(s.random.integers(1, 4)),
        phase=s.angle(),
    ),
    "presliding": lambda s: effects.Presliding(s.joint, width=0.03 * s.strength),
    "armature": lambda s: effects.Armature(s.joint, inertia=0.3 * s.strength * s.inertia()),
    "joint_elasticity": lambda s: effects.JointElasticity(
        s.joint, stiffness=float(torque_scale(s.arm.robot)[s.joint]) / (0.02 * s.strength)
    ),
    "torque_ripple": lambda s: effects.TorqueRipple(
        s.joint,
        amplitude=0.02 * s.torque,
        harmonic=float(s.random.integers(2, 13)),
        phase=s.angle(),
    ),
    "position_spring": lambda s: effects.PositionSpring(
        s.joint, stiffness=0.05 * s.torque, rest=0.3 * s.angle()
    ),
    "transmission_coupling": lambda s: effects.TransmissionCoupling(
        s.joint,
        source=s.neighbour(),
        viscous_coefficient=0.03 * s.torque / s.speed,
        coulomb=0.02 * s.torque,
    ),
    "torque_gain": lambda s: effects.TorqueGain(s.joint, gain=s.sign() * 0.08 * s.strength),
    "torque_delay": lambda s: effects.TorqueDelay(s.joint, delay=0.02 * s.strength),
    "torque_lowpass": lambda s: effects.TorqueLowpass(s.joint, time_constant=0.02 * s.strength),
    "time_shift": lambda s: effects.TimeShift(delay=0.02 * s.strength),
    "bias_drift": lambda s: effects.BiasDrift(s.joint, rate=s.sign() * 0.002 * s.torque),
    "encoder_offset": lambda s: effects.EncoderOffset(s.joint, offset=s.sign() * 0.05 * s.strength),
    "base_tilt": lambda s: effects.BaseTilt(
        about_x=s.sign() * 0.06 * s.strength, about_y=s.sign() * 0.04 * s.strength
    ),
    "payload": lambda s: effects.Payload(
        mass=0.05 * s.strength * s.weight() / 9.81, com=s.three(0.05)
    ),
    "external_wrench": lambda s: effects.ExternalWrench(
        moment=s.three(0.005 * s.strength * s.weight()),
        force=s.three(0.05 * s.strength * s.weight()),
    ),
}

HIDDEN_EFFECT_NAMES: tuple[str, ...] = tuple(sorted(_MAKERS))
