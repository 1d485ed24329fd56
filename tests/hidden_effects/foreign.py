"""Effects that no library has: a diagnosis should report them as unexplained, with signals."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from hidden_effects.scalable_effect import ReferenceMotion, ScalableEffect, with_effect
from numpy.typing import NDArray

from lieid_casadi.plant import ForeignTorque, JointState

Array = NDArray[np.float64]
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
