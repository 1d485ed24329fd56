"""Result of `discriminate`: the motion, and how well it separates each pair of rivals."""

from __future__ import annotations

import io
import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from lieid_casadi.arrays import Array
from lieid_casadi.excitation.trajectory import MotionSamples, Trajectory, csv_text, period_grid
from lieid_casadi.model import Model
from lieid_casadi.output_folder import write_folder
from lieid_casadi.plot_style import Axes, Figure, drawing
from lieid_casadi.tables import html

ABSENCE = "its absence"  # the rival of an effect that has no other


@dataclass(frozen=True, eq=False)
class RivalPair:
    """One effect as the true one, the other as the rival that is fitted instead."""

    true: str  # label
    rival: str  # label, or ABSENCE
    noncentrality: float  # of one period: squared residual of the refit relative to the noise
    needed: float  # noncentrality at which the rival is rejected with the required power
    remaining: float  # part of the true effect's weighted torque that the refit leaves, 0 to 1
    separable: bool  # False if the rival contains the true effect: no motion separates them
    residual: Array  # (N, n): torque that the refit leaves along the period, N·m


@dataclass(frozen=True, eq=False)
class Discrimination:
    """Result of :func:`lieid_casadi.discrimination.discriminate`."""

    model: Model  #: the rivals' common model
    trajectory: Trajectory  #: one period, at rest at both ends
    periods: int  #: how often it must be run for the worst pair
    level: float  #: of the test and its power: 0.95 rejects a wrong rival at 5 % in 95 % of cases
    sizes: dict[str, list[float]]  #: label → assumed coefficients, then shape parameters
    pairs: tuple[RivalPair, ...]
    max_violation: float  #: of the limits on a fine grid, relative to each; margins are negative
    evaluations: int  #: of the criterion
    solve_seconds: float
    rate: float  #: of the trajectory file, Hz
    interrupted: bool = False  #: by Ctrl-C
    checked: tuple[str, ...] = ()  #: limits that were checked
    unchecked: tuple[str, ...] = ()  #: limits that were not

    @property
    def seconds(self) -> float:
        """Duration that separates the effects, in whole periods, s."""
        return self.periods * self.trajectory.duration

    @property
    def exact_seconds(self) -> float:
        """Duration that separates the effects, not rounded to whole periods, s."""
        return self.trajectory.duration * max(
            p.needed / p.noncentrality for p in self.pairs if p.separable
        )

    def motion(self, *, rate: float | None = None, periods: int = 1) -> MotionSamples:
        """Return samples of the motion at a rate in Hz, including the end at rest."""
        duration = self.trajectory.duration
        count = max(round(duration * (rate or self.rate)), 2)
        grid = np.concatenate([period_grid(duration, count) for _ in range(periods)] + [[duration]])
        t = np.append(np.arange(periods * count) * duration / count, periods * duration)
        motion = self.trajectory.at(grid)
        return MotionSamples(t, motion.q, motion.dq, motion.ddq)

    def to_dict(self) -> dict[str, Any]:
        """Return the content of ``discriminate.json``; joints from 1."""
        return {
            "robot": self.model.robot.name,
            "effects": list(self.sizes),
            "sizes": self.sizes,
            "level": self.level,
            "seconds": self.seconds,
            "exact_seconds": self.exact_seconds,
            "duration": self.trajectory.duration,
            "periods": self.periods,
            "pairs": [
                {name: value for name, value in vars(p).items() if name != "residual"}
                for p in self.pairs
            ],
            "max_violation": self.max_violation,
            "checked": list(self.checked),
            "unchecked": list(self.unchecked),
            "evaluations": self.evaluations,
            "interrupted": self.interrupted,
            "solve_seconds": self.solve_seconds,
            "coefficients": self.trajectory.coefficients.tolist(),
        }

    def summary(self) -> str:
        """Return the result in sentences."""
        them = "them" if len(self.sizes) > 1 else f"it from {ABSENCE}"
        text = (
            f"{' and '.join(self.sizes)}: {self.seconds:.4g} s of this motion "
            f"({self.periods} × {self.trajectory.duration:.4g} s) separate {them} with "
            f"{100.0 * self.level:.4g} % confidence"
        )
        contained = [f"{p.true} from {p.rival}" for p in self.pairs if not p.separable]
        if contained:
            text += (
                ". Not separable by any motion, because the second contains the first: "
                f"{', '.join(contained)}"
            )
        text += f".\nThese limits are met: {'; '.join(self.checked)}."
        return f"{text}\nNot checked: {'; '.join(self.unchecked)}."

    def plot(self, ax: Axes | None = None) -> Figure:
        """Draw the torque that each rival's refit leaves on the joint where it is largest."""
        figure, ax = drawing(ax, 9.0, 3.5)
        for pair in self.pairs:
            if pair.separable:
                j = int(np.argmax(np.square(pair.residual).sum(axis=0)))
                t = period_grid(self.trajectory.duration, len(pair.residual))
                label = f"{pair.true}, not explained by {pair.rival} (joint {j + 1})"
                ax.plot(t, pair.residual[:, j], linewidth=1.2, label=label)
        ax.set_xlabel("time, s")
        ax.set_ylabel("residual torque, N·m")
        ax.set_title(
            f"{self.seconds:.4g} s separate them with {100.0 * self.level:.4g} % confidence"
        )
        ax.legend(fontsize="small")
        return figure

    def save(self, folder: str | Path, *, force: bool = False) -> tuple[Path, ...]:
        """Write ``trajectory.csv`` (one period), ``discriminate.json``, ``discriminate.png``.

        The folder is made, and written as a whole or not at all; an `OutputError` refuses one with
        other content. ``force`` replaces what an earlier call wrote; other files are kept.
        """
        image = io.BytesIO()
        self.plot().savefig(image, format="png", dpi=120)
        content = json.dumps(
            {"schema": 1} | self.to_dict(), indent=1, ensure_ascii=False, allow_nan=False
        )
        files = {
            "trajectory.csv": csv_text(self.motion(), self.checked, self.unchecked).encode(),
            "discriminate.json": content.encode(),
            "discriminate.png": image.getvalue(),
        }
        return write_folder(folder, files, force=force)

    def _repr_html_(self) -> str:
        return html(self.summary())

    def __repr__(self) -> str:
        return f"<Discrimination of {' and '.join(self.sizes)}: {self.seconds:.4g} s>"
