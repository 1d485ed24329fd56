"""Result of a design: the trajectory, its quality, and the verified limits."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from lieid_casadi.errors import LieidWarning, warning_list
from lieid_casadi.excitation.approach_motion import RestToRest
from lieid_casadi.excitation.basis.trajectory import MotionSamples, Trajectory
from lieid_casadi.excitation.criteria.quality import Quality
from lieid_casadi.excitation.solvers.tracker import IterationRecord
from lieid_casadi.json_numbers import number_or_none
from lieid_casadi.model import Model

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Array = NDArray[np.float64]


@dataclass(frozen=True)
class StartSummary:
    """Result of one start; NaN where it found no trajectory. ``seed`` is None for a file."""

    seed: int | None
    condition_number: float
    neg_log_det: float
    seconds: float
    first_condition_number: float


@dataclass(frozen=True)
class ActiveLimit:
    """A limit that the motion comes within 1 % of: ``used``, 0 to 1, of ``quantity``."""

    quantity: str
    used: float


@dataclass(frozen=True, eq=False)
class Excitation:
    """Result of :func:`lieid_casadi.excite`.

    Attributes
    ----------
    trajectory : Trajectory
        One period.
    periods : int
    rest_pose : (n,)
        Pose at which the whole motion begins and ends, rad.
    approach : RestToRest
        Motion from the rest pose to the start of the trajectory; at the end it runs backwards.
    rate : float
        Of the files, Hz.
    samples : int
        Of the criterion over one period.
    quality : Quality
        Condition number and singular values at the samples.
    criterion, scaling : str
    max_violation : float
        Largest excess over any limit on a grid 20 times finer than the samples, in the limit's
        unit; 0 if every limit holds.
    active_limits : tuple of ActiveLimit
        Limits that the motion comes within 1 % of, the closest first.
    starts : tuple of StartSummary
    history : tuple of IterationRecord
        Of the best start.
    build_seconds, solve_seconds : float
        For derivation and compilation; for optimization and verification of all starts.
    interrupted : bool
        Whether the user interrupted the search; the trajectory is the best so far.
    checked, unchecked : tuple of str
        Limits that were checked, and limits that were not.
    warnings : tuple of LieidWarning
        Effects that the design could not take into account.
    """

    model: Model
    trajectory: Trajectory
    periods: int
    rest_pose: Array
    approach: RestToRest
    rate: float
    samples: int
    quality: Quality
    criterion: str
    scaling: str
    max_violation: float
    active_limits: tuple[ActiveLimit, ...]
    starts: tuple[StartSummary, ...]
    history: tuple[IterationRecord, ...]
    build_seconds: float
    solve_seconds: float
    interrupted: bool = False
    checked: tuple[str, ...] = ()
    unchecked: tuple[str, ...] = ()
    warnings: tuple[LieidWarning, ...] = field(default=())

    @property
    def condition_number(self) -> float:
        """σ₁/σ_r of the stacked full regressor (scaled according to ``scaling``)."""
        return self.quality.condition_number

    @property
    def neg_log_det(self) -> float:
        """−log det of the base regressor's Gram matrix, SI."""
        return self.quality.neg_log_det

    @property
    def start(self) -> float:
        """Time at which the periods of the trajectory begin, s."""
        return self.approach.duration

    @property
    def end(self) -> float:
        """Time at which they end, s."""
        return self.start + self.periods * self.trajectory.duration

    @property
    def duration(self) -> float:
        """Length of the whole motion, s."""
        return self.end + self.approach.duration

    def motion(self, rate: float | None = None) -> MotionSamples:
        """Return samples of the whole motion at a rate in Hz."""
        step = 1.0 / (self.rate if rate is None else rate)
        count = int(np.floor(self.duration / step + 1e-9)) + 1
        return self.at(step * np.arange(count, dtype=np.float64))

    def at(self, t: Array) -> MotionSamples:
        """Return the whole motion at times (N,) from 0 to ``duration``, s."""
        time = np.asarray(t, dtype=float)
        n = self.model.n
        parts = np.zeros((4, len(time), n))
        before, after = time < self.start, time > self.end
        inside = ~(before | after)
        phase = time[inside] - self.start
        phase = phase - self.trajectory.duration * np.floor(
            np.minimum(phase / self.trajectory.duration, self.periods - 1e-12)
        )
        for mask, part in (
            (inside, self.trajectory.at(phase)),
            (before, self.approach.at(time[before]) if before.any() else None),
            (after, self._return_motion(time[after]) if after.any() else None),
        ):
            if part is not None:
                parts[:, mask] = part.q, part.dq, part.ddq, part.dddq
        return MotionSamples(time, *parts)

    def _return_motion(self, time: Array) -> MotionSamples:
        backwards = RestToRest(self.approach.end, self.approach.start, self.approach.duration)
        return backwards.at(time - self.end)

    @property
    def coefficients(self) -> dict[str, Any]:
        """The trajectory's coefficients; for the Fourier series those of Eq. 19."""
        values = self.trajectory.coefficients
        basis = self.trajectory.basis
        result: dict[str, Any] = {"family": basis.name, "duration": basis.duration}
        if basis.name == "fourier":
            harmonics = (values.shape[1] - 1) // 2
            result["base_frequency"] = 1.0 / basis.duration
            result["q0"] = values[:, 0].tolist()
            result["a"] = values[:, 1 : harmonics + 1].tolist()
            result["b"] = values[:, harmonics + 1 :].tolist()
        else:
            result["values"] = values.tolist()
        return result

    def to_dict(self) -> dict[str, Any]:
        """Return the JSON of ``lieid excite``."""
        rank = self.quality.rank
        sizes = self.quality.singular_values
        return {
            "robot": self.model.robot.name,
            "effects": self.model.effects,
            "criterion": self.criterion,
            "scaling": self.scaling,
            "condition_number": self.condition_number,
            "singular_values": {
                "largest": float(sizes[0]),
                "smallest": float(sizes[rank - 1]),
                "beyond": float(sizes[rank]) if rank < len(sizes) else None,
            },
            "neg_log_det": self.neg_log_det,
            "base_parameter_count": rank,
            "start": self.start,
            "end": self.end,
            "duration": self.duration,
            "periods": self.periods,
            "samples": self.samples,
            "rate": self.rate,
            "rest_pose": self.rest_pose.tolist(),
            "max_violation": self.max_violation,
            "checked": list(self.checked),
            "unchecked": list(self.unchecked),
            "active_limits": [
                {"quantity": limit.quantity, "used": limit.used} for limit in self.active_limits
            ],
            "weak": [
                {
                    "singular_value": w.singular_value,
                    "parameters": [{"name": name, "share": share} for name, share in w.parameters],
                }
                for w in self.quality.weak
            ],
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
        """Return a text summary: quality, active limits, weakest directions."""
        from lieid_casadi.excitation.summary import summary

        return summary(self)

    def plot(self, ax: None = None) -> Figure:
        """Return a figure: positions within limits, path of the tool, history of the criterion."""
        from lieid_casadi.excitation.plots import plot

        return plot(self)

    def save(self, folder: str | Path, *, force: bool = False) -> tuple[Path, ...]:
        """Write trajectory, JSON, plot, text and ROS 2 message into a folder; return the files.

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
        from lieid_casadi.excitation.files import save

        return save(self, Path(folder), force=force)

    def _repr_html_(self) -> str:
        from lieid_casadi.excitation.summary import html

        return html(self)

    def __repr__(self) -> str:
        return (
            f"Excitation({self.model.robot.name}, {self.duration:.4g} s, "
            f"condition number {self.condition_number:.4g})"
        )


def active_limits(quantities: Sequence[tuple[str, float]]) -> tuple[ActiveLimit, ...]:
    """Return the quantities that come within 1 % of their limits, the closest first."""
    active = [ActiveLimit(name, used) for name, used in quantities if used > 0.99]
    return tuple(sorted(active, key=lambda limit: -limit.used))
