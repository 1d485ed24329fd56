"""Strengths for which effects leave a stated multiple of the noise after a fit."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from hidden_effects.base_span import (
    BaseSpan,
    NoiselessRecord,
    columns,
    noiseless_record,
    whitened,
)
from hidden_effects.case_setup import CaseSetup, with_hidden
from hidden_effects.scalable_effect import ScalableEffect
from numpy.typing import NDArray

from lieid_casadi.plant import Arm, move_along

Array = NDArray[np.float64]
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
