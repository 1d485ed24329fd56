"""Effects whose class a library has, in a form that it does not have.

A diagnosis should name the class, or report the residual with the right signal first.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from hidden_effects.foreign import Torque, foreign
from hidden_effects.scalable_effect import EffectFactory, ReferenceMotion, ScalableEffect
from numpy.typing import NDArray

from lieid_casadi import plant

Array = NDArray[np.float64]
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
