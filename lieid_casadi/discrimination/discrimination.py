"""Result of `discriminate`: the motion, and what it tells apart."""

from __future__ import annotations

import io
import json
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from lieid_casadi.excitation.basis.trajectory import MotionSamples, Trajectory, period_grid
from lieid_casadi.excitation.files import csv_text
from lieid_casadi.model import Model
from lieid_casadi.output_folder import write_folder

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Pair:
    """One effect as the truth, the other as the rival that tries to explain it.

    Attributes
    ----------
    true, rival : str
    noncentrality : float
        Of the likelihood ratio, per period: what the rival's refit leaves, over the noise.
    needed : float
        Noncentrality at which the rival is rejected with the power asked for.
    remaining : float
        Part of the true effect's weighted torque that is left, 0 to 1.
    told : bool
        False where the rival's refit explains the effect whatever the motion: it contains it.
    left : (N, n)
        Torque that the rival's refit leaves along the period, N·m.
    """

    true: str
    rival: str
    noncentrality: float
    needed: float
    remaining: float
    told: bool
    left: Array


@dataclass(frozen=True, eq=False)
class Discrimination:
    """Result of :func:`lieid_casadi.discrimination.discriminate`.

    Attributes
    ----------
    model : Model
        What the rivals share.
    trajectory : Trajectory
        One period, at rest at both ends.
    periods : int
        How often it is to be run: as many as the worst pair needs.
    level : float
        Of the test and its power: 0.95 rejects a wrong rival at 5 % in 95 % of the cases.
    sizes : dict
        Coefficients, then shapes, that each effect was given.
    pairs : tuple of Pair
    random : float
        Seconds that the median of the random motions tried would take.
    max_violation : float
        Of the limits on a fine grid, in parts of each; negative is room.
    evaluations : int
    interrupted : bool
        Whether Ctrl-C ended the search.
    """

    model: Model
    trajectory: Trajectory
    periods: int
    level: float
    sizes: dict[str, list[float]]
    pairs: tuple[Pair, ...]
    random: float
    max_violation: float
    evaluations: int
    solve_seconds: float
    rate: float
    interrupted: bool = False

    @property
    def seconds(self) -> float:
        """Seconds of motion that tell the effects apart: whole periods."""
        return self.periods * self.trajectory.duration

    @property
    def exact_seconds(self) -> float:
        """The same without rounding to whole periods."""
        return self.trajectory.duration * max(
            p.needed / p.noncentrality for p in self.pairs if p.told
        )

    def motion(self, *, rate: float | None = None, periods: int = 1) -> MotionSamples:
        """Return samples of some periods, the end at rest included."""
        duration = self.trajectory.duration
        count = max(round(duration * (rate or self.rate)), 2)
        grid = np.concatenate([period_grid(duration, count) for _ in range(periods)] + [[duration]])
        t = np.append(np.arange(periods * count) * duration / count, periods * duration)
        motion = self.trajectory.at(grid)
        return MotionSamples(t, motion.q, motion.dq, motion.ddq)

    def to_dict(self) -> dict[str, Any]:
        """Return what ``discriminate.json`` holds; joints from 1."""
        return {
            "robot": self.model.robot.name,
            "effects": list(self.sizes),
            "sizes": self.sizes,
            "level": self.level,
            "seconds": self.seconds,
            "exact_seconds": self.exact_seconds,
            "random_seconds": self.random if np.isfinite(self.random) else None,
            "duration": self.trajectory.duration,
            "periods": self.periods,
            "pairs": [
                {
                    "true": p.true,
                    "rival": p.rival,
                    "noncentrality": p.noncentrality,
                    "needed": p.needed,
                    "remaining": p.remaining,
                    "told": p.told,
                }
                for p in self.pairs
            ],
            "max_violation": self.max_violation,
            "evaluations": self.evaluations,
            "interrupted": self.interrupted,
            "solve_seconds": self.solve_seconds,
            "coefficients": self.trajectory.coefficients.tolist(),
        }

    def summary(self) -> str:
        """Return the answer in words."""
        text = (
            f"{' and '.join(self.sizes)}: {self.seconds:.4g} s of this motion "
            f"({self.periods} × {self.trajectory.duration:.4g} s) tell them apart at "
            f"{100.0 * self.level:.4g} %"
        )
        if np.isfinite(self.random):
            text += f"; a random motion takes about {self.random:.2g} s"
        contained = [f"{p.true} by {p.rival}" for p in self.pairs if not p.told]
        if contained:
            text += f". Never told, since the rival contains it: {', '.join(contained)}"
        return text + "."

    def plot(self, ax: Axes | None = None) -> Figure:
        """Draw the torque that each rival's refit leaves, on the joint where it is largest."""
        from matplotlib.figure import Figure as NewFigure

        if ax is None:
            figure = NewFigure(figsize=(9.0, 6.0), layout="constrained")
            upper, ax = figure.subplots(2, 1, sharex=True)
            motion = self.motion(rate=100.0)
            for j in range(self.model.n):
                upper.plot(motion.t, motion.q[:, j], linewidth=1.2, label=f"q{j + 1}")
            upper.set_ylabel("position, rad")
            upper.legend(ncols=self.model.n, fontsize="small")
        told = [p for p in self.pairs if p.told]
        for pair in told:
            j = int(np.argmax(np.square(pair.left).sum(axis=0)))
            t = period_grid(self.trajectory.duration, len(pair.left))
            label = f"{pair.true}, not explained by {pair.rival} (joint {j + 1})"
            ax.plot(t, pair.left[:, j], linewidth=1.2, label=label)
        ax.set_xlabel("time, s")
        ax.set_ylabel("torque left, N·m")
        ax.set_title(f"{self.seconds:.4g} s tell them apart at {100.0 * self.level:.4g} %")
        ax.legend(fontsize="small")
        drawn = ax.get_figure(root=True)
        assert drawn is not None
        return drawn

    def save(self, folder: str | Path, *, force: bool = False) -> tuple[Path, ...]:
        """Write ``trajectory.csv`` (one period), ``discriminate.json``, ``discriminate.png``.

        Parameters
        ----------
        folder : str or Path
            Made if it does not exist; written as a whole or not at all.
        force : bool
            Replace what an earlier call wrote into it; other files are kept.

        Raises
        ------
        OutputError
            The folder has other content or cannot be written.
        """
        image = io.BytesIO()
        self.plot().savefig(image, format="png", dpi=120)
        content = json.dumps(self.to_dict(), indent=1, ensure_ascii=False, allow_nan=False)
        files = {
            "trajectory.csv": csv_text(self.motion()).encode(),
            "discriminate.json": content.encode(),
            "discriminate.png": image.getvalue(),
        }
        return write_folder(folder, files, force=force)

    def _repr_html_(self) -> str:
        from html import escape

        return f"<p>{escape(self.summary())}</p>"
