"""How strong an effect must be to leave a stated multiple of the noise."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from hidden_effects.hidden import Hidden
from hidden_effects.sizes import Clean, Space, clean
from hidden_effects.stage import Stage, hide
from numpy.typing import NDArray

from lieid_casadi.plant import Arm, move_along

Array = NDArray[np.float64]
CLOSE = 0.01  # of the stated size
ABSORBED = 1e-4  # part of a torque below which nothing is left to find
ROWS, PLAN_ROWS = 1500, 600  # instants that sizes are computed from
PLAN_RATE = 200.0  # Hz


class Sizing:
    """How much of each effect is left on a motion of the links."""

    def __init__(
        self, stage: Stage, t: Array, path: tuple[Array, Array, Array], rows: int = ROWS
    ) -> None:
        self.stage, self.t, self.path = stage, t, path
        self._rate = min(rows, t.size - 1) / float(t[-1] - t[0])
        self.base = self._record(self._arm([], []))
        self._space = Space(stage.arm.robot, self.base, stage.noise)

    def _arm(self, hidden: list[Hidden], strengths: list[float]) -> Arm:
        return hide(self.stage, hidden, strengths, self.stage.counts)

    def _record(self, arm: Arm) -> Clean:
        record = clean(arm, move_along(arm, self.t, *self.path), self._rate)
        return replace(record, moving=self.base.moving) if hasattr(self, "base") else record

    def contribution(self, hidden: Hidden, strength: float) -> tuple[Space, Array]:
        """Return the space of columns and the torque (R,) that is the effect's, over noise.

        It is the measured torque less what the arm without the effect would take on the motion
        that the encoders show.
        """
        arm = self._arm([hidden], [strength])
        record = self._record(arm)
        base = self._arm([], [])
        # The encoders' motion may differ from the links': then its own columns count.
        if np.array_equal(record.q, self.base.q) and np.array_equal(record.dq, self.base.dq):
            space, expected = self._space, self.base.tau
        else:
            space = Space(arm.robot, record, self.stage.noise)
            shown = move_along(base, record.t, record.q, record.dq, record.ddq)
            expected = shown.tau
        return space, space.stacked(record.tau - expected)

    def left(self, space: Space, torque: Array, beside: list[Array]) -> Array:
        """Return what is left of a torque (R,) when all else has been fitted."""
        others = np.column_stack(beside) if beside else None
        if not self.stage.changed:
            return space.left(torque, others)
        if others is None:
            return torque
        return torque - others @ np.linalg.lstsq(others, torque, rcond=None)[0]

    def size(
        self, hidden: Hidden, strength: float, beside: list[Array]
    ) -> tuple[float, float, Array, Space]:
        """Return size, part of the torque that is left, what is left (R,), and the space."""
        space, torque = self.contribution(hidden, strength)
        left = self.left(space, torque, beside)
        whole = float(np.linalg.norm(torque))
        part = float(np.linalg.norm(left)) / whole if whole else 0.0
        return float(space.by_joint(left).max()), part, left, space

    def together(
        self, hidden: list[Hidden], strengths: list[float]
    ) -> list[tuple[float, float, Array, Space]]:
        """Return each effect's `size` beside the others."""
        pairs = list(zip(hidden, strengths, strict=True))
        torques = [self.contribution(*pair)[1] for pair in pairs]
        return [
            self.size(*pair, [t for i, t in enumerate(torques) if i != k])
            for k, pair in enumerate(pairs)
        ]


def planned(stage: Stage, run: int, rate: float) -> tuple[Array, tuple[Array, Array, Array]]:
    plan = stage.plans[run]
    t = np.arange(round(plan.duration * rate) + 1) / rate
    return t, plan.at(t)


def find_strengths(
    stage: Stage, hidden: list[Hidden], targets: list[float]
) -> tuple[list[float], float] | None:
    """Return strengths and a factor on the noise that give the sizes on the planned motion.

    None where a strength, or the noise, would be implausible.
    """
    if not hidden:
        return [], 1.0
    sizing = Sizing(stage, *planned(stage, stage.counts, PLAN_RATE), PLAN_ROWS)
    louder = 1.0
    for one, target in zip(hidden, targets, strict=True):
        if one.fixed:
            louder = sizing.size(one, one.most, [])[0] / target
    strengths = [
        _alone(sizing, one, louder * target) for one, target in zip(hidden, targets, strict=True)
    ]
    for _ in range(6):
        if any(s is None for s in strengths) or not stage.plausible(louder):
            return None
        sizes = [size / louder for size, *_ in sizing.together(hidden, strengths)]
        ratios = np.array(targets) / np.maximum(sizes, 1e-12)
        if np.all(np.abs(ratios - 1.0) < CLOSE):
            return strengths, louder
        for one, ratio in zip(hidden, ratios, strict=True):
            if one.fixed:
                louder /= ratio
                ratios = ratios * (1.0 / ratio)
        strengths = [
            s if one.fixed else _within(one, float(s * r))
            for one, s, r in zip(hidden, strengths, ratios, strict=True)
        ]
    return None


def _within(one: Hidden, strength: float) -> float | None:
    return strength if one.least <= strength <= one.most else None


def _alone(sizing: Sizing, one: Hidden, target: float) -> float | None:
    """Return the strength that gives one effect its size, by the secant of the logarithms."""
    if one.fixed:
        return one.most
    if np.isfinite(one.most):
        # At the limits first: most implausible draws end here.
        s = one.most
        size, part, _, _ = sizing.size(one, s, [])
        if size < target or part < ABSORBED:
            return None
    else:
        s = float(target * sizing.stage.noise[one.joints[0]])
        size = sizing.size(one, s, [])[0]
    if one.least and sizing.size(one, one.least, [])[0] > target:
        return None
    slope = 1.0
    for _ in range(12):
        if size <= 0.0:
            return None
        if abs(size / target - 1.0) < CLOSE:
            return s
        new = float(np.clip(s * (target / size) ** (1.0 / slope), one.least, one.most))
        if new == s:
            return None
        after = sizing.size(one, new, [])[0]
        if after > 0.0:
            slope = float(np.clip(np.log(after / size) / np.log(new / s), 0.5, 2.0))
        s, size = new, after
    return None
