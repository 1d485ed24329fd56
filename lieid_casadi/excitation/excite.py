"""``excite``: design of an optimal excitation trajectory, and its result."""

from __future__ import annotations

import io
import json
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from lieid_casadi.arrays import Array
from lieid_casadi.blas_threads import blas_on_one_thread
from lieid_casadi.errors import ExcitationError, LieidWarning, NoSolution, warning_list
from lieid_casadi.excitation.checks import MARGIN, control_times, verify
from lieid_casadi.excitation.criteria import (
    Criterion,
    CriterionExpression,
    CriterionName,
    Quality,
    criterion_name,
    design_model,
    quality,
)
from lieid_casadi.excitation.design import ExcitationProblem
from lieid_casadi.excitation.limits import Limit
from lieid_casadi.excitation.sample_functions import IdentifiedModel, model_and_fit
from lieid_casadi.excitation.search import StartAttempt, solve_all
from lieid_casadi.excitation.trajectory import (
    Fourier,
    MotionSamples,
    Trajectory,
    csv_text,
    period_grid,
)
from lieid_casadi.json_numbers import number_or_none
from lieid_casadi.model import Model
from lieid_casadi.output_folder import write_folder
from lieid_casadi.plot_style import Axes, Figure, drawing
from lieid_casadi.robot import Robot
from lieid_casadi.tables import html

MOST_ROWS = 10_000_000  # of a trajectory file
PLOTTED = 600  # samples of a figure


@blas_on_one_thread
def excite(
    source: Model | Robot | IdentifiedModel,
    *,
    criterion: CriterionName | CriterionExpression | Criterion = "combined",
    inertial_only: bool = False,
    limits: Sequence[Limit] | None = None,
    start_pose: ArrayLike | None = None,
    acceleration: ArrayLike | None = None,
    margin: float = MARGIN,
    duration: float = 20.0,
    harmonics: int = 5,
    samples: int = 100,
    rate: float = 1000.0,
    starts: int = 4,
    seed: int = 0,
    max_iterations: int | None = None,
    progress: Callable[[str, float], None] = lambda stage, fraction: None,
) -> Excitation:
    """Design an optimal excitation trajectory within limits.

    By default joint limits, torque, tool speed, a floor at the base plane and self-collision are
    checked. The finished motion is verified by other means than those of the search:
    `Excitation.checked` lists what this covered, joint by joint and link by link, and
    `Excitation.unchecked` the rest.

    The criterion evaluates the model's own regressor, effects included, as far as its columns
    follow from the motion and the time; warnings name the effects that do not (temperature,
    memory, effects on the whole arm).

    Parameters
    ----------
    source : Model, Robot or Fit
    criterion : str or callable
        ``combined`` (the paper's C1: condition number with a bound on −log det), ``condition``
        (C2), ``hadamard`` (C3) or ``logdet`` (C4); or a function of the information matrix
        G = Y_bᵀY_b, SX (p, p) in the order of ``model.base_columns``, that returns the scalar
        expression to be minimized (a logarithm is well scaled); or a
        `lieid_casadi.excitation.Criterion` with a derivative of its own.
    inertial_only : bool
        Leave the model's effects out, for comparison with the literature.
    limits : sequence of Limit, optional
        Limits besides those of the joints: `Torque`, `CartesianSpeed`, `Wall`, `Obstacle`,
        `SelfCollision`, or objects of your own with the method of
        `lieid_casadi.excitation.Limit`. Default: those of `default_limits`, which yours may
        follow: ``limits=[*default_limits(robot), mine]``; ``()`` leaves all out.
    start_pose : (n,), optional
        Pose at rest at start and end, rad. Default: the middle of the joint ranges or, where that
        is near a limit or a singular pose, one that is far from both.
    acceleration : float or (n,), optional
        Limits in place of the robot's, rad/s². Default: 3 where the robot states none.
    margin : float
        Part of the velocity limits, and of the torque limits by default, that is used.
    duration : float
        Length of one period, s.
    harmonics : int
        Of the period's frequency, in the Fourier series (Eq. 19).
    samples : int
        Of the criterion over a period; limits are verified on a grid 20 times finer, and at 1 kHz.
    rate : float
        Of the files, Hz.
    starts : int
        Number of random starts; the best trajectory is returned.
    seed : int
        Of the first start; the others follow. The rounding of the linear algebra depends on the
        processor, and the search amplifies it: between OpenBLAS kernels the condition number of
        the best of four starts changes by 1 to 10 %.
    max_iterations : int, optional
        Most iterations of one start; without it each stage of the search ends by its own
        tolerance. There is no limit in seconds, so that results do not depend on the load of the
        machine.
    progress : callable
        Called with what is done and the fraction that is done. An interrupt (Ctrl-C) keeps the
        best trajectory so far.

    Returns
    -------
    Excitation

    Raises
    ------
    ExcitationError
        Limits that are missing or contradictory, a start pose outside of them.
    NoSolution
        No start led to a trajectory within all limits, or the verification of the motion failed;
        names the limit and what to relax.
    """
    began = time.monotonic()
    model = model_and_fit(source)[0]
    _check(rate, duration, seed, starts=starts, max_iterations=max_iterations)
    progress("compiling", 0.0)
    problem = ExcitationProblem(
        source, basis=Fourier(harmonics, duration), criterion=criterion,
        inertial_only=inertial_only, limits=limits, start_pose=start_pose,
        acceleration=acceleration, margin=margin, samples=samples,
    )  # fmt: skip
    built = time.monotonic()
    seeds = range(seed, seed + starts)
    attempts = solve_all(problem, seeds, progress=progress, max_iterations=max_iterations)
    z = best_of(attempts)
    trajectory = problem.parametrization.trajectory(z)
    motion = trajectory.at(control_times(trajectory.duration))
    verified = verify(model.robot, motion, problem.range, problem.limits, problem.fit)
    excesses = problem.excesses(z)
    return Excitation(
        model=problem.model, trajectory=trajectory, rest_pose=problem.pose,
        rate=rate, samples=samples, criterion=criterion_name(criterion),
        quality=quality(
            problem.model, trajectory.at(period_grid(trajectory.duration, samples)), problem.fit
        ),
        max_violation=max(0.0, *(excess.value for excess in excesses)),
        starts=tuple(attempts),
        build_seconds=built - began, solve_seconds=time.monotonic() - built,
        checked=verified.checked, unchecked=verified.unchecked,
        interrupted=any(a.interrupted for a in attempts),
        warnings=() if inertial_only else design_model(model)[1],
    )  # fmt: skip


def _check(rate: float, duration: float, seed: int, **counts: int | None) -> None:
    """Refuse counts below 1, and a rate at which the trajectory file would be too long."""
    for name, count in counts.items():
        if count is not None and count < 1:
            raise ExcitationError(f"{name}: {count}; expected 1 at least")
    if seed < 0:
        raise ExcitationError(f"seed: {seed}; expected 0 or a positive integer")
    if not rate > 0.0:
        raise ExcitationError(f"rate: {rate:g} Hz; expected a positive number")
    if rate * duration > MOST_ROWS:
        raise ExcitationError(
            f"rate: {rate:g} Hz gives {rate * duration:.3g} rows in {duration:g} s; expected at "
            f"most {MOST_ROWS}: lower the rate"
        )


def best_of(attempts: Sequence[StartAttempt]) -> Array:
    """Return z (m,) of the best of several starts; raise the first's reason where all fail."""
    found = [(a, a.z) for a in attempts if a.z is not None]
    if not found:
        count = f" ({len(attempts)} starts)" if len(attempts) > 1 else ""
        raise NoSolution(f"{attempts[0].reason}{count}")
    return min(found, key=lambda pair: pair[0].rank)[1]


@dataclass(frozen=True, eq=False)
class Excitation:
    """Result of :func:`lieid_casadi.excite`."""

    model: Model
    trajectory: Trajectory  #: periodic: a robot may repeat it
    rest_pose: Array  #: (n,): at which the motion begins and ends, rad
    rate: float  #: of the files, Hz
    samples: int  #: of the criterion
    quality: Quality  #: condition number and singular values at the samples
    criterion: str
    #: largest excess over any limit on a grid 20 times finer than the samples, in the limit's unit
    max_violation: float
    starts: tuple[StartAttempt, ...]
    build_seconds: float  #: for derivation and compilation
    solve_seconds: float  #: for optimization and verification of all starts
    interrupted: bool = False  #: by the user: the trajectory is the best so far
    #: limits with the joints, links and pairs for which the motion was verified to keep them
    checked: tuple[str, ...] = ()
    unchecked: tuple[str, ...] = ()  #: everything for which it was not
    warnings: tuple[LieidWarning, ...] = ()  #: effects that the design could not take into account

    @property
    def condition_number(self) -> float:
        """σ₁/σ_r of the stacked full regressor, SI."""
        return self.quality.condition_number

    @property
    def neg_log_det(self) -> float:
        """−log det of the base regressor's Gram matrix, SI."""
        return self.quality.neg_log_det

    @property
    def duration(self) -> float:
        """Length of the motion, s."""
        return self.trajectory.duration

    def motion(self, rate: float | None = None) -> MotionSamples:
        """Return samples of the motion at a rate in Hz."""
        step = 1.0 / (self.rate if rate is None else rate)
        count = int(np.floor(self.duration / step + 1e-9)) + 1
        return self.trajectory.at(step * np.arange(count, dtype=np.float64))

    @property
    def coefficients(self) -> dict[str, Any]:
        """Coefficients of the Fourier series (Eq. 19)."""
        values, duration = self.trajectory.coefficients, self.trajectory.duration
        harmonics = (values.shape[1] - 1) // 2
        return {
            "family": "fourier",
            "duration": duration,
            "base_frequency": 1.0 / duration,
            "q0": values[:, 0].tolist(),
            "a": values[:, 1 : harmonics + 1].tolist(),
            "b": values[:, harmonics + 1 :].tolist(),
        }

    def to_dict(self) -> dict[str, Any]:
        """Return the JSON of ``lieid excite``."""
        rank = self.quality.rank
        sizes = self.quality.singular_values
        return {
            "robot": self.model.robot.name,
            "effects": self.model.effects,
            "criterion": self.criterion,
            "condition_number": self.condition_number,
            "singular_values": {
                "largest": float(sizes[0]),
                "smallest": float(sizes[rank - 1]),
                "beyond": float(sizes[rank]) if rank < len(sizes) else None,
            },
            "neg_log_det": self.neg_log_det,
            "base_parameter_count": rank,
            "start": 0.0,
            "end": self.duration,
            "duration": self.duration,
            "samples": self.samples,
            "rate": self.rate,
            "rest_pose": self.rest_pose.tolist(),
            "max_violation": self.max_violation,
            "checked": list(self.checked),
            "unchecked": list(self.unchecked),
            "starts": [
                {
                    "seed": s.seed,
                    "condition_number": number_or_none(s.condition_number),
                    "neg_log_det": number_or_none(s.neg_log_det),
                    "seconds": s.seconds,
                }
                for s in self.starts
            ],
            "solve_seconds": self.solve_seconds,
            "build_seconds": self.build_seconds,
            "interrupted": self.interrupted,
            "coefficients": self.coefficients,
            "warnings": warning_list(self.warnings),
        }

    def summary(self) -> str:
        """Return a text summary: quality, what was checked, active limits."""
        q = self.quality
        effects = ", ".join(self.model.effects) or "no effects"
        lines = [
            f"Excitation of {self.model.robot.name}: {self.duration:.4g} s.",
            f"Condition number {self.condition_number:.4g} (σ₁ {q.singular_values[0]:.4g}, "
            f"σ_r {q.singular_values[q.rank - 1]:.4g} of the full regressor at {self.samples} "
            f"samples, SI, {effects}); −log det {self.neg_log_det:.4g} for {q.rank} base "
            "parameters. Solved by Ipopt.",
            "These limits are met at 1 kHz (largest excess "
            f"{self.max_violation:.1g}): {'; '.join(self.checked)}.",
            f"Not checked: {'; '.join(self.unchecked)}.",
        ]
        if self.interrupted:
            lines.append("The search was interrupted; this is the best trajectory so far.")
        lines += [f"! {warning}" for warning in self.warnings]
        return "\n".join(lines)

    def plot(self, ax: Axes | None = None) -> Figure:
        """Draw the positions of all joints within their limits and return the figure."""
        figure, ax = drawing(ax, 9.0, 5.0)
        motion = self.trajectory.at(np.linspace(0.0, self.duration, PLOTTED))
        plot_positions(motion, self.model.robot, ax)
        ax.set_title(
            f"{self.model.robot.name}: condition number {self.condition_number:.4g}, "
            f"{self.duration:.4g} s; grey: range of the joint",
            parse_math=False,  # "$" in a robot's name is no formula
        )
        return figure

    def save(self, folder: str | Path, *, force: bool = False) -> tuple[Path, ...]:
        """Write trajectory, JSON, plot and text into a folder; return the files.

        The folder is made, and written as a whole or not at all; an `OutputError` refuses one with
        other content. ``force`` replaces what an earlier call wrote; other files are kept.
        """
        content = {"schema": 1} | self.to_dict()
        figure = io.BytesIO()
        self.plot().savefig(figure, format="png", dpi=120)
        files = {
            "trajectory.csv": csv_text(self.motion(), self.checked, self.unchecked).encode(),
            "excitation.json": json.dumps(content, indent=1, ensure_ascii=False).encode(),
            "excitation.png": figure.getvalue(),
            "summary.txt": (self.summary() + "\n").encode(),
        }
        return write_folder(Path(folder), files, force=force)

    def _repr_html_(self) -> str:
        return html(*self.summary().split("\n"))

    def __repr__(self) -> str:
        return (
            f"Excitation({self.model.robot.name}, {self.duration:.4g} s, "
            f"condition number {self.condition_number:.4g})"
        )


def plot_positions(motion: MotionSamples, robot: Robot, ax: Axes) -> None:
    """Draw the position of each joint in parts of its range, one row per joint."""
    t, q = motion.t, motion.q
    low, high = robot.limit("position_lower"), robot.limit("position_upper")
    low = np.where(np.isfinite(low), low, q.min(axis=0))
    high = np.where(np.isfinite(high), high, q.max(axis=0))
    for j in range(robot.n):
        share = (q[:, j] - low[j]) / max(high[j] - low[j], 1e-9)
        row = robot.n - 1 - j
        ax.fill_between([t[0], t[-1]], row + 0.06, row + 0.94, color="0.93", linewidth=0)
        ax.plot(t, row + 0.06 + 0.88 * share, linewidth=1.4)
    ax.set_yticks(np.arange(robot.n) + 0.5, [f"q{j}" for j in range(robot.n, 0, -1)])
    ax.set_ylim(0.0, robot.n)
    ax.set_xlim(t[0], t[-1])
    ax.set_xlabel("time, s")
