"""Sizes of hidden effects: what a fit of the base model leaves of their torque, in noise.

All columns are defined here, by Pinocchio's regressor and closed forms, independently of the
package's dynamics and effects. They are evaluated along the noiseless motion as the encoders
measure it, so that the torque of an arm without hidden effects lies in the span of rigid body and
plain friction. If the columns of another effect explain nearly all of the unexplained torque of a
hidden effect, data of this noise cannot separate the two.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from hidden_effects.case_setup import CaseSetup, with_hidden
from hidden_effects.effect_library import ScalableEffect
from numpy.typing import NDArray

from lieid_casadi.arrays import Array
from lieid_casadi.plant import (
    Arm,
    EncoderOffset,
    Sensors,
    TrueMotion,
    build_pinocchio,
    measure,
    move_along,
)
from lieid_casadi.plant.sensors import sampled_rows

SLOWEST = 1e-3  # rad/s, m/s: below it dry friction is undetermined
SINGULAR = 1e-9  # of the largest singular value


@dataclass(frozen=True, eq=False)
class NoiselessRecord:
    """Recording of ideal sensors at a reduced rate: (K, n) arrays, t is (K,)."""

    t: Array
    q: Array
    dq: Array
    ddq: Array
    tau: Array
    load: Array
    moving: NDArray[np.bool_]


def noiseless_record(arm: Arm, motion: TrueMotion, rate: float) -> NoiselessRecord:
    """Return an arm's noiseless recording of a motion at a rate (Hz), with the acceleration."""
    t, rows = motion.t, sampled_rows(motion.t, rate)
    ideal = measure(arm, motion, Sensors(rate=rate))
    q = motion.motor_q.copy()
    for effect in arm.effects_of(EncoderOffset):
        q[:, effect.joint] -= effect.offset
    assert ideal.tau is not None
    moving = ~motion.resting & (np.abs(motion.motor_dq) > SLOWEST)
    return NoiselessRecord(
        t[rows], q[rows], motion.motor_dq[rows], motion.motor_ddq[rows],
        ideal.tau, motion.rigid[rows], moving[rows],
    )  # fmt: skip


def columns(robot, record: NoiselessRecord) -> Array:
    """Return rigid, Coulomb, viscous and offset columns (K, n, 10 n + 3 n)."""
    import pinocchio as pin

    model = build_pinocchio(robot)
    data, n = model.createData(), robot.n
    whole = np.zeros((len(record.t), n, 13 * n))
    for k in range(len(record.t)):
        whole[k, :, : 10 * n] = pin.computeJointTorqueRegressor(
            model, data, record.q[k], record.dq[k], record.ddq[k]
        )
    joints = np.arange(n)
    whole[:, joints, 10 * n + joints] = np.sign(record.dq)
    whole[:, joints, 11 * n + joints] = record.dq
    whole[:, joints, 12 * n + joints] = 1.0
    return whole


def whitened(values: Array, seen: NDArray[np.bool_], t: Array, white: Array, time: float) -> Array:
    """Return the innovations (K, n, m) of a Kalman filter for white and first-order noise.

    Both together have unit variance; ``white`` (n,) is the part of white noise, ``time`` the
    correlation time (s) of the rest. Rows (K, n) that are not ``seen`` give zero.
    """
    state, shown = np.zeros(values.shape[1:]), np.zeros(values.shape)
    variance = 1.0 - white
    keep = np.exp(-np.diff(t, prepend=t[0]) / time)
    for k in range(len(t)):
        state = keep[k] * state
        variance = keep[k] ** 2 * variance + (1.0 - keep[k] ** 2) * (1.0 - white)
        whole = variance + np.maximum(white, 1e-6)
        error = np.where(seen[k][:, None], values[k] - state, 0.0)
        shown[k] = error / np.sqrt(whole)[:, None]
        gain = np.where(seen[k], variance / whole, 0.0)
        state = state + gain[:, None] * error
        variance = variance * (1.0 - gain)
    return shown


class BaseSpan:
    """Span of the columns of the base model; rows of each joint are divided by its noise."""

    def __init__(self, robot, record: NoiselessRecord, noise: Array) -> None:
        self.record, self.noise = record, noise
        weighted = self.stacked(columns(robot, record))
        scale = np.linalg.norm(weighted, axis=0)
        q, r = np.linalg.qr(weighted / np.where(scale > 0.0, scale, 1.0))
        u, s, _ = np.linalg.svd(r)
        self.basis = q @ u[:, s > SINGULAR * s[0]]

    def stacked(self, values: Array) -> Array:
        """Return values (K, n, …) in motion, divided by the noise, joint after joint (R, …)."""
        parts = [
            values[self.record.moving[:, j], j] / self.noise[j]
            for j in range(self.record.q.shape[1])
        ]
        return np.concatenate(parts)

    def outside(self, stacked: Array, further: Array | None = None) -> Array:
        """Return the part of (R, …) that base columns and further columns (R, m) do not span."""
        rest = stacked - self.basis @ (self.basis.T @ stacked)
        rest = rest - self.basis @ (self.basis.T @ rest)
        if further is None or not further.size:
            return rest
        others = self.outside(further)
        q, r = np.linalg.qr(others)
        q = q[:, np.abs(np.diag(r)) > 1e-9 * max(np.abs(np.diag(r)).max(), 1e-12)]
        return rest - q @ (q.T @ rest)

    def unstacked(self, stacked: Array) -> Array:
        """Return the values (K, n) of stacked rows (R,); zero where a joint rests."""
        values = np.zeros(self.record.q.shape)
        parts = np.split(stacked, np.cumsum(self.record.moving.sum(axis=0))[:-1])
        for j, part in enumerate(parts):
            values[self.record.moving[:, j], j] = part * self.noise[j]
        return values

    def by_joint(self, stacked: Array) -> Array:
        """Return the RMS (n,) of stacked rows per joint, in multiples of the noise."""
        counts = self.record.moving.sum(axis=0)
        parts = np.split(stacked, np.cumsum(counts)[:-1])
        return np.array([np.sqrt(np.mean(p * p)) if len(p) else 0.0 for p in parts])


TOLERANCE = 0.01  # relative, of sizes
ABSORBED = 1e-4  # part of a torque below which the effect cannot be identified
ROWS, PLAN_ROWS = 1500, 600  # instants that sizes are computed from
PLAN_RATE = 200.0  # Hz


class EffectSizes:
    """The part of the torque of each effect that the base model does not explain, on a motion."""

    def __init__(
        self, setup: CaseSetup, t: Array, path: tuple[Array, Array, Array], rows: int = ROWS
    ) -> None:
        self.setup, self.t, self.path = setup, t, path
        self._rate = min(rows, t.size - 1) / float(t[-1] - t[0])
        self.base = self._record(self._arm([], []))
        self._span = BaseSpan(setup.arm.robot, self.base, setup.noise)

    def _arm(self, hidden: list[ScalableEffect], strengths: list[float]) -> Arm:
        return with_hidden(self.setup, hidden, strengths, self.setup.counts)

    def _record(self, arm: Arm) -> NoiselessRecord:
        record = noiseless_record(arm, move_along(arm, self.t, *self.path), self._rate)
        return replace(record, moving=self.base.moving) if hasattr(self, "base") else record

    def contribution(self, hidden: ScalableEffect, strength: float) -> tuple[BaseSpan, Array]:
        """Return the span of the base columns and the torque (R,) of the effect over noise.

        The torque of the effect is the measured torque minus that of the arm without the effect
        on the motion that the encoders measure.
        """
        arm = self._arm([hidden], [strength])
        record = self._record(arm)
        base = self._arm([], [])
        # the encoders may measure another motion than that of the links
        if np.array_equal(record.q, self.base.q) and np.array_equal(record.dq, self.base.dq):
            span, expected = self._span, self.base.tau
        else:
            span = BaseSpan(arm.robot, record, self.setup.noise)
            shown = move_along(base, record.t, record.q, record.dq, record.ddq)
            expected = shown.tau
        return span, span.stacked(record.tau - expected)

    def deviations(self, span: BaseSpan, torque: Array) -> float:
        """Return how far a torque (R,) stands above the noise, in its standard deviations.

        The noise and its correlation are those of the sensors, and the base model is fitted along
        with the torque (unless it is kept): the square root of the noncentrality of the best test.
        """
        sensors, noise, record = self.setup.sensors, self.setup.noise, span.record
        coloured = np.array(sensors.coloured_noise) ** 2 / noise**2
        thinner = (len(record.t) - 1) / (record.t[-1] - record.t[0]) / float(sensors.rate or 1.0)
        white = (1.0 - coloured) * min(thinner, 1.0)
        scale = np.sqrt(coloured + white)
        values = span.unstacked(torque)[:, :, None]
        if not self.setup.changed:
            values = np.concatenate([values, columns(self.setup.arm.robot, record)], axis=2)
        shown = whitened(
            values / (noise * scale)[:, None], record.moving, record.t, white / scale**2,
            max(sensors.correlation_time, 1e-6),
        ).reshape(-1, values.shape[2])  # fmt: skip
        effect, rest = shown[:, 0], shown[:, 1:]
        if rest.shape[1]:
            rest = rest / np.maximum(np.linalg.norm(rest, axis=0), 1e-12)
            u, s, _ = np.linalg.svd(rest, full_matrices=False)
            u = u[:, s > 1e-9 * s[0]]
            effect = effect - u @ (u.T @ effect)
        return float(np.linalg.norm(effect))

    def unexplained(self, span: BaseSpan, torque: Array, further: list[Array]) -> Array:
        """Return the part of a torque (R,) that the base model and further torques do not span."""
        others = np.column_stack(further) if further else None
        if not self.setup.changed:
            return span.outside(torque, others)
        if others is None:
            return torque
        return torque - others @ np.linalg.lstsq(others, torque, rcond=None)[0]

    def size(
        self, hidden: ScalableEffect, strength: float, further: list[Array]
    ) -> tuple[float, float, Array, BaseSpan]:
        """Return size, unexplained part (0 to 1), unexplained torque (R,), and the span."""
        span, torque = self.contribution(hidden, strength)
        left = self.unexplained(span, torque, further)
        whole = float(np.linalg.norm(torque))
        part = float(np.linalg.norm(left)) / whole if whole else 0.0
        return float(span.by_joint(left).max()), part, left, span

    def together(
        self, hidden: list[ScalableEffect], strengths: list[float]
    ) -> list[tuple[float, float, Array, BaseSpan]]:
        """Return the `size` of each effect in addition to the others."""
        pairs = list(zip(hidden, strengths, strict=True))
        torques = [self.contribution(*pair)[1] for pair in pairs]
        return [
            self.size(*pair, [t for i, t in enumerate(torques) if i != k])
            for k, pair in enumerate(pairs)
        ]


def planned(setup: CaseSetup, run: int, rate: float) -> tuple[Array, tuple[Array, Array, Array]]:
    plan = setup.plans[run]
    t = np.arange(round(plan.duration * rate) + 1) / rate
    return t, plan.at(t)


def find_strengths(
    setup: CaseSetup, hidden: list[ScalableEffect], targets: list[float]
) -> tuple[list[float], float] | None:
    """Return strengths and a factor for the noise that give the sizes on the planned motion.

    None if a strength or the noise would be unrealistic.
    """
    if not hidden:
        return [], 1.0
    sizing = EffectSizes(setup, *planned(setup, setup.counts, PLAN_RATE), PLAN_ROWS)
    noise_factor = 1.0
    for one, target in zip(hidden, targets, strict=True):
        if one.fixed:
            noise_factor = sizing.size(one, one.most, [])[0] / target
    strengths = [
        _strength_alone(sizing, one, noise_factor * target)
        for one, target in zip(hidden, targets, strict=True)
    ]
    for _ in range(6):
        if any(s is None for s in strengths) or not setup.plausible(noise_factor):
            return None
        sizes = [size / noise_factor for size, *_ in sizing.together(hidden, strengths)]
        ratios = np.array(targets) / np.maximum(sizes, 1e-12)
        if np.all(np.abs(ratios - 1.0) < TOLERANCE):
            return strengths, noise_factor
        for one, ratio in zip(hidden, ratios, strict=True):
            if one.fixed:
                noise_factor /= ratio
                ratios = ratios * (1.0 / ratio)
        strengths = [
            s if one.fixed else _within(one, float(s * r))
            for one, s, r in zip(hidden, strengths, ratios, strict=True)
        ]
    return None


def _within(one: ScalableEffect, strength: float) -> float | None:
    return strength if one.least <= strength <= one.most else None


def _strength_alone(sizing: EffectSizes, one: ScalableEffect, target: float) -> float | None:
    """Return the strength that gives one effect its size, by the secant method on logarithms."""
    if one.fixed:
        return one.most
    if np.isfinite(one.most):
        # most unrealistic draws fail at the limits
        s = one.most
        size, part, _, _ = sizing.size(one, s, [])
        if size < target or part < ABSORBED:
            return None
    else:
        s = float(target * sizing.setup.noise[one.joints[0]])
        size = sizing.size(one, s, [])[0]
    if one.least and sizing.size(one, one.least, [])[0] > target:
        return None
    slope = 1.0
    for _ in range(12):
        if size <= 0.0:
            return None
        if abs(size / target - 1.0) < TOLERANCE:
            return s
        new = float(np.clip(s * (target / size) ** (1.0 / slope), one.least, one.most))
        if new == s:
            return None
        after = sizing.size(one, new, [])[0]
        if after > 0.0:
            slope = float(np.clip(np.log(after / size) / np.log(new / s), 0.5, 2.0))
        s, size = new, after
    return None


SimilarColumns = tuple[str, tuple[int, ...], Array]


def most_similar(
    span: BaseSpan, left: Array, joint: int, truth: tuple[str, tuple[int, ...]], *, kept: bool
) -> tuple[str, float]:
    """Return the most similar effect on one joint and the part of ``left`` (R,) that it explains.

    With ``kept`` the base model is not fitted again, so that its columns are not projected out.
    """
    tried = [
        (name, joints, matrix)
        for name, joints, matrix in similar_columns(span.record, joint)
        if (name, joints) != truth
    ]
    values = np.zeros((*span.record.q.shape, sum(m.shape[1] for *_, m in tried)))
    values[:, joint] = np.concatenate([m for *_, m in tried], axis=1)
    stacked = span.stacked(values)
    projected = stacked if kept else span.outside(stacked)
    present = np.linalg.norm(projected, axis=0) > 1e-6 * np.linalg.norm(stacked, axis=0)
    best, part, first = "", 0.0, 0
    whole = float(left @ left)
    for name, joints, matrix in tried:
        own = slice(first, first + matrix.shape[1])
        first = own.stop
        columns = projected[:, own]
        if not whole or not present[own].all():
            continue  # absorbed
        gram, along = columns.T @ columns, columns.T @ left
        explained = float(along @ np.linalg.lstsq(gram, along, rcond=None)[0]) / whole
        if explained > part:
            best, part = f"{name}:{'<'.join(str(k + 1) for k in joints)}", explained
    return best, part


def similar_columns(r: NoiselessRecord, j: int) -> Iterator[SimilarColumns]:
    """Yield name, joints and columns (K, m) of the effects of a library on joint j."""
    q, dq, sign = r.q[:, j], r.dq[:, j], np.sign(r.dq[:, j])
    here, fast = (j,), float(np.abs(dq).max()) + 1e-9
    yield "coulomb", here, sign[:, None]
    yield "viscous", here, dq[:, None]
    yield "offset", here, np.ones((len(q), 1))
    yield "viscous_polynomial", here, np.column_stack([sign * dq**2, dq**3])
    yield "viscous_asymmetric", here, np.abs(dq)[:, None]
    for v in fast * np.geomspace(0.01, 0.7, 12):
        yield "stribeck", here, (sign * np.exp(-((dq / v) ** 2)))[:, None]
    yield "load_friction", here, (np.abs(r.load[:, j]) * sign)[:, None]
    for k in np.arange(0.5, 8.1, 0.25):
        waves = np.column_stack([np.sin(k * q), np.cos(k * q)])
        yield "position_friction", here, waves * sign[:, None]
    for k in np.concatenate([np.arange(1.75, 20.0, 0.25), np.arange(20.0, 121.0, 1.0)]):
        yield "torque_ripple", here, np.column_stack([np.sin(k * q), np.cos(k * q)])
    yield "armature", here, r.ddq[:, j, None]
    yield "position_spring", here, q[:, None]
    yield "bias_drift", here, (r.t - r.t.mean())[:, None]
    yield "torque_gain", here, r.tau[:, j, None]
    yield "torque_delay", here, np.gradient(r.tau[:, j], r.t)[:, None]
    for theta in np.geomspace(0.1, 1.0, 4) * float(r.t[-1] - r.t[0]):
        warmed = 1.0 - np.exp(-r.t / theta)
        yield "warm_up", here, np.column_stack([warmed * sign, warmed * dq])
    for i in range(r.q.shape[1]):
        if i != j:
            other = np.column_stack([r.dq[:, i], np.sign(r.dq[:, i])])
            yield "transmission_coupling", (j, i), other
    for width in np.geomspace(0.003, 0.3, 7):
        yield "presliding", here, (_dahl(q, width) - sign)[:, None]


def _dahl(q: Array, width: float) -> Array:
    z, steps = np.zeros(len(q)), np.diff(q)
    for k, step in enumerate(steps):
        toward = np.sign(step)
        z[k + 1] = toward + (z[k] - toward) * np.exp(-abs(step) / width)
    return z
