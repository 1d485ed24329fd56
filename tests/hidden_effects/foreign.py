"""Effects that no library has, and forms that it does not have of effects whose class it has.

A diagnosis should report foreign effects as a shape or as unexplained, with their signals; of a
form it should name the class, or report the residual with the right signal first.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from hidden_effects.effect_library import (
    EffectFactory,
    ReferenceMotion,
    ScalableEffect,
    with_effect,
)

from lieid_casadi import plant
from lieid_casadi.arrays import Array
from lieid_casadi.plant import ForeignTorque, JointState

Torque = Callable[[JointState], Array]


def foreign(
    name: str, j: int, signals: tuple[str, ...], torque: Torque, *, simulated: bool = True
) -> ScalableEffect:
    def make(strength: float) -> ForeignTorque:
        return ForeignTorque(j, function=lambda s: strength * np.asarray(torque(s)))

    return ScalableEffect(name, (j,), with_effect(make), np.inf, signals, simulated)


def _other(g: ReferenceMotion, j: int) -> int:
    return int(g.random.choice([k for k in range(g.n) if k != j and g.revolute(k)]))


def _bump(g: ReferenceMotion, j: int) -> ScalableEffect:
    """A Lorentzian bump somewhere along the turn."""
    span = float(g.upper[j] - g.lower[j])
    centre = float(g.lower[j]) + span * float(g.random.uniform(0.3, 0.7))
    width = span * g.log(0.03, 0.1)
    return foreign(
        "bump", j, (f"q{j + 1}",), lambda s: 1.0 / (1.0 + ((s.q[..., j] - centre) / width) ** 2)
    )


def _end_stop(g: ReferenceMotion, j: int) -> ScalableEffect:
    """A bumper that is compressed near one end of the range."""
    span, up = float(g.upper[j] - g.lower[j]), g.sign()
    start = float(g.upper[j]) - 0.15 * span if up > 0 else float(g.lower[j]) + 0.15 * span
    return foreign(
        "end_stop", j, (f"q{j + 1}",),
        lambda s: up * np.maximum(up * (s.q[..., j] - start), 0.0) / span,
    )  # fmt: skip


def _cogging_of_other(g: ReferenceMotion, j: int) -> ScalableEffect:
    """Cogging that depends on the angle of another joint."""
    i, k, phase = _other(g, j), float(g.random.integers(2, 6)), g.angle()
    return foreign("cogging_of_other", j, (f"q{i + 1}",), lambda s: np.sin(k * s.q[..., i] + phase))


def _spring_from_other(g: ReferenceMotion, j: int) -> ScalableEffect:
    """The torque of a hose between two joints."""
    i = _other(g, j)
    return foreign(
        "spring_from_other", j, (f"q{i + 1}",), lambda s: np.maximum(s.q[..., i] - 0.3, 0.0) ** 2
    )


def _rough_spot(g: ReferenceMotion, j: int) -> ScalableEffect:
    """Dry friction that is larger in a narrow range of angles."""
    i = _revolute(g, j)
    span = float(g.upper[i] - g.lower[i])
    centre = float(g.lower[i]) + span * float(g.random.uniform(0.3, 0.7))
    width = span * g.log(0.05, 0.1)
    return foreign(
        "rough_spot", i, (f"dq{i + 1}", f"q{i + 1}"),
        lambda s: s.sign[..., i] / (1.0 + ((s.q[..., i] - centre) / width) ** 2),
    )  # fmt: skip


def _friction_by_other_angle(g: ReferenceMotion, j: int) -> ScalableEffect:
    """Dry friction that varies with another joint's angle."""
    i, phase = _other(g, j), g.angle()
    return foreign(
        "friction_by_other_angle", j, (f"dq{j + 1}", f"q{i + 1}"),
        lambda s: np.sin(s.q[..., i] + phase) * s.sign[..., j],
    )  # fmt: skip


def _viscous_by_angle(g: ReferenceMotion, j: int) -> ScalableEffect:
    """Viscous friction that varies along the turn."""
    i, phase, v = _revolute(g, j), g.angle(), float(g.speed[_revolute(g, j)])
    return foreign(
        "viscous_by_angle", i, (f"dq{i + 1}", f"q{i + 1}"),
        lambda s: np.sin(2.0 * s.q[..., i] + phase) * s.dq[..., i] / v,
    )  # fmt: skip


def _friction_peak(g: ReferenceMotion, j: int) -> ScalableEffect:
    """Friction with a peak at one speed, as of a resonance."""
    v = float(g.speed[j]) * float(g.random.uniform(0.3, 0.5))
    return foreign(
        "friction_peak", j, (f"dq{j + 1}",),
        lambda s: np.exp(-(((np.abs(s.dq[..., j]) - v) / (0.25 * v)) ** 2)) * s.sign[..., j],
    )  # fmt: skip


def _product_of_velocities(g: ReferenceMotion, j: int) -> ScalableEffect:
    """Torque in proportion to the product of two joint velocities."""
    i = _other(g, j)
    return foreign(
        "product_of_velocities", j, (f"dq{i + 1}", f"dq{j + 1}"),
        lambda s: s.dq[..., i] * s.dq[..., j] / float(g.speed[i] * g.speed[j]),
    )  # fmt: skip


def _drag_of_other(g: ReferenceMotion, j: int) -> ScalableEffect:
    """|q̇| of another joint."""
    i = _other(g, j)
    return foreign(
        "drag_of_other", j, (f"dq{i + 1}",), lambda s: np.abs(s.dq[..., i]) / float(g.speed[i])
    )


def _load_backlash(g: ReferenceMotion, j: int) -> ScalableEffect:
    """A step where the load changes its sign."""
    i = _loaded(g)
    width = 0.05 * float(g.load[i])
    return foreign("load_backlash", i, (f"load{i + 1}",), lambda s: np.tanh(s.load[..., i] / width))


def _load_hysteresis(g: ReferenceMotion, j: int) -> ScalableEffect:
    """Play in the transmission: a torque that lags behind the load by a fixed width."""
    i = _loaded(g)
    width = 0.15 * float(g.load[i])

    def lag(s: JointState) -> Array:
        load, behind = s.load[..., i], np.zeros(s.load.shape[0])
        behind[0] = load[0]
        for k in range(1, len(behind)):
            behind[k] = min(max(behind[k - 1], load[k] - width), load[k] + width)
        return (load - behind) / width

    return foreign("load_hysteresis", i, (f"load{i + 1}",), lag, simulated=False)


def _slow_hum(g: ReferenceMotion, j: int) -> ScalableEffect:
    """A torque that oscillates slowly with time."""
    cycles, phase = float(g.random.uniform(1.3, 2.5)), g.angle()
    return foreign(
        "slow_hum", j, ("t",), lambda s: np.sin(2.0 * np.pi * cycles * s.t / g.duration + phase)
        * np.ones(s.q.shape[:-1]),
    )  # fmt: skip


def _friction_step(g: ReferenceMotion, j: int) -> ScalableEffect:
    """Dry friction that increases at one instant."""
    start = g.duration * float(g.random.uniform(0.3, 0.7))
    return foreign(
        "friction_step", j, ("t", f"dq{j + 1}"), lambda s: np.where(s.t >= start, 1.0, 0.0)
        * s.sign[..., j],
    )  # fmt: skip


def _product_of_other_velocities(g: ReferenceMotion, j: int) -> ScalableEffect:
    """Torque in proportion to the product of the velocities of two other joints."""
    i, k = (int(x) for x in g.random.choice([x for x in range(g.n) if x != j], 2, replace=False))
    return foreign(
        "product_of_other_velocities", j, (f"dq{i + 1}", f"dq{k + 1}"),
        lambda s: s.dq[..., i] * s.dq[..., k] / float(g.speed[i] * g.speed[k]),
    )  # fmt: skip


def _cross_talk(g: ReferenceMotion, j: int) -> ScalableEffect:
    """A part of the torque of another joint in the signal of this one."""
    i = int(g.random.choice([k for k in np.argsort(g.load)[-3:] if k != j]))
    friction = g.arm.friction
    return foreign(
        "cross_talk", j, (f"load{i + 1}|tau{i + 1}",), lambda s: s.load[..., i]
        + friction.coulomb[i] * s.sign[..., i] + friction.viscous[i] * s.dq[..., i]
        + friction.offset[i], simulated=False,
    )  # fmt: skip


def _friction_by_acceleration(g: ReferenceMotion, j: int) -> ScalableEffect:
    """|q̈|·sgn q̇."""
    return foreign(
        "friction_by_acceleration", j, (f"dq{j + 1}", f"ddq{j + 1}"),
        lambda s: np.abs(np.gradient(s.dq[..., j], s.t)) * s.sign[..., j], simulated=False,
    )  # fmt: skip


def _revolute(g: ReferenceMotion, j: int) -> int:
    """Return the joint, or the next revolute one."""
    return j if g.revolute(j) else (j + 1) % g.n


def _loaded(g: ReferenceMotion) -> int:
    """Return a joint whose load is large relative to its drive."""
    return int(np.argsort(g.load / g.torque)[-int(g.random.integers(1, 3))])


FOREIGN = {
    "bump": _bump,
    "end_stop": _end_stop,
    "cogging_of_other": _cogging_of_other,
    "spring_from_other": _spring_from_other,
    "rough_spot": _rough_spot,
    "friction_by_other_angle": _friction_by_other_angle,
    "viscous_by_angle": _viscous_by_angle,
    "friction_peak": _friction_peak,
    "product_of_velocities": _product_of_velocities,
    "drag_of_other": _drag_of_other,
    "load_backlash": _load_backlash,
    "load_hysteresis": _load_hysteresis,
    "slow_hum": _slow_hum,
    "friction_step": _friction_step,
    "product_of_other_velocities": _product_of_other_velocities,
    "cross_talk": _cross_talk,
    "friction_by_acceleration": _friction_by_acceleration,
}


ELEMENTS = 3  # of the Maxwell-slip model


def _form(
    name: str,
    j: int,
    accepted: tuple[str, ...],
    torque: Torque,
    signals: tuple[str, ...] = (),
    most: float = np.inf,
    *,
    simulated: bool = True,
) -> ScalableEffect:
    effect = foreign(name, j, signals or (f"dq{j + 1}",), torque, simulated=simulated)
    return replace(effect, accepted=accepted, most=most)


def _stribeck_lorentzian(g: ReferenceMotion, j: int) -> ScalableEffect:
    """Hess and Soom 1990: the excess falls with 1/(1 + (q̇/v)²)."""
    v = g.log(0.03, 0.2) * float(g.speed[j])
    return _form(
        "stribeck_lorentzian", j, ("stribeck",),
        lambda s: s.sign[..., j] / (1.0 + (s.dq[..., j] / v) ** 2),
    )  # fmt: skip


def _stribeck_exponential(g: ReferenceMotion, j: int) -> ScalableEffect:
    """The excess falls with e^{−|q̇|/v}."""
    v = g.log(0.03, 0.2) * float(g.speed[j])
    return _form(
        "stribeck_exponential", j, ("stribeck",),
        lambda s: s.sign[..., j] * np.exp(-np.abs(s.dq[..., j]) / v),
    )  # fmt: skip


def _load_friction_root(g: ReferenceMotion, j: int) -> ScalableEffect:
    """Friction with the square root of the load."""
    i = int(np.argsort(g.load / g.torque)[-int(g.random.integers(1, 3))])
    whole = max(float(g.load[i]), 1e-6)
    return _form(
        "load_friction_root", i, ("load_friction",),
        lambda s: s.sign[..., i] * np.sqrt(np.abs(s.load[..., i]) / whole),
        (f"load{i + 1}", f"dq{i + 1}"),
    )  # fmt: skip


def _tanh_friction(g: ReferenceMotion, j: int) -> ScalableEffect:
    """Dry friction f_c·tanh(q̇/v): what is missing at low speed from f_c·sgn(q̇)."""
    v = g.log(0.05, 0.25) * float(g.speed[j])
    return _form(
        "tanh_friction", j, ("stribeck", "presliding", "viscous_polynomial"),
        lambda s: np.tanh(s.dq[..., j] / v) - s.sign[..., j],
        most=float(g.arm.friction.coulomb[j]),
    )  # fmt: skip


def _maxwell_slip(g: ReferenceMotion, j: int) -> ScalableEffect:
    """Hysteresis of several spring and slider elements in parallel, in place of the sign."""
    widths = np.array([g.log(0.003, 0.1) for _ in range(ELEMENTS)]) * (1 if g.revolute(j) else 0.3)

    def lag(s: plant.JointState) -> Array:
        q = s.q[..., j]
        behind = np.zeros((len(q), ELEMENTS))
        for k in range(1, len(q)):
            behind[k] = np.clip(behind[k - 1] + (q[k] - q[k - 1]) / widths, -1.0, 1.0)
        return np.asarray(behind.mean(axis=1) - s.sign[..., j])

    return _form(
        "maxwell_slip", j, ("presliding",), lag, most=float(g.arm.friction.coulomb[j]),
        simulated=False,
    )  # fmt: skip


def _two_mass(g: ReferenceMotion, j: int) -> ScalableEffect | None:
    """A rotor behind a spring whose resonance is inside the band; the noise is scaled."""
    if not g.revolute(j) or g.load[j] < 1e-3:
        return None
    inertia = g.log(0.01, 0.04) * float(g.torque[j])
    compliance = g.log(0.005, 0.03) / float(g.load[j])

    def hide(arm: plant.Arm, strength: float, run: int) -> plant.Arm:
        return arm.with_effects(
            plant.JointElasticity(j, stiffness=1.0 / compliance), plant.Armature(j, inertia=inertia)
        )

    return ScalableEffect(
        "two_mass", (j,), hide, 1.0, least=1.0, elastic=True,
        signals=(f"q{j + 1}", f"dq{j + 1}", f"ddq{j + 1}", f"load{j + 1}"),
        accepted=("joint_elasticity", "armature"),
    )  # fmt: skip


def _bam(model: int) -> EffectFactory:
    """Friction of Rhoban's servo models M2 to M6 beyond Coulomb and viscous friction.

    Duclusaud et al. 2025, "Extended friction models for the physics simulation of servo
    actuators": with the motor's torque τ_m, the external torque τ_e and S = e^{−|q̇/v|^α},

    - M2: k_s·S; M3: k_l·|τ_m − τ_e|; M4: both, and k_ls·|τ_m − τ_e|·S
    - M5: |k_e·τ_e − k_m·τ_m| in place of |τ_m − τ_e|
    - M6: M5 and, under S, the square of the smaller torque
    """
    loaded, stribeck, directional, quadratic = model >= 3, model != 3, model >= 5, model == 6
    accepted = ("load_friction",) * loaded + ("stribeck",) * stribeck

    def make(g: ReferenceMotion, j: int) -> ScalableEffect:
        i = int(np.argsort(g.load / g.torque)[-int(g.random.integers(1, 3))]) if loaded else j
        v, alpha = g.log(0.03, 0.2) * float(g.speed[i]), float(g.random.uniform(1.0, 2.0))
        dry, by_load, by_both, squared = g.random.uniform(0.3, 1.0, 4)
        motor_part = float(g.random.uniform(0.2, 0.8))
        friction, whole = g.arm.friction, max(float(g.load[i]), 1e-6)

        def torque(s: plant.JointState) -> Array:
            sign, load = s.sign[..., i], s.load[..., i]
            plain = friction.coulomb[i] * sign + friction.viscous[i] * s.dq[..., i]
            external, motor = -load, load + plain
            parts = (1.0 - motor_part, motor_part) if directional else (0.5, 0.5)
            gear = np.abs(parts[0] * external - parts[1] * motor) / whole
            slow = np.exp(-(np.abs(s.dq[..., i] / v) ** alpha))
            found = loaded * by_load * gear
            if stribeck:
                found = found + slow * (dry + loaded * by_both * gear)
            if quadratic:
                smaller = np.minimum(np.abs(external), np.abs(motor)) / whole
                found = found + slow * squared * smaller**2 * (external * motor < 0.0)
            return np.asarray(found * sign)

        signals = (f"dq{i + 1}", f"load{i + 1}") if loaded else (f"dq{i + 1}",)
        return _form(f"bam_m{model}", i, accepted, torque, signals, simulated=False)

    return make


FORMS: dict[str, EffectFactory] = {
    "stribeck_lorentzian": _stribeck_lorentzian,
    "stribeck_exponential": _stribeck_exponential,
    "load_friction_root": _load_friction_root,
    "tanh_friction": _tanh_friction,
    "maxwell_slip": _maxwell_slip,
    "two_mass": _two_mass,
} | {f"bam_m{model}": _bam(model) for model in range(2, 7)}
