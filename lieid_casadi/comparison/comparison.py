"""Result of a comparison: errors per joint, largest errors, and the time series."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from lieid_casadi.comparison.largest_errors import LargeError
from lieid_casadi.comparison.time_series import Series
from lieid_casadi.errors import LieidWarning, warning_list
from lieid_casadi.identification.provenance import Source
from lieid_casadi.json_numbers import numbers_or_none

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Array = NDArray[np.float64]
REST_MATTERS = 0.25  # of a joint's squared error: from this on, rest is reported


@dataclass(frozen=True, eq=False)
class Comparison:
    """Result of :func:`lieid_casadi.compare`; errors are measured − predicted.

    Numbers refer to processed signals, measured and predicted through the fit's filter, unless
    called raw. They are NaN, in JSON None, if there are no samples to compute them from.

    Attributes
    ----------
    joint_names : tuple of str
    units : tuple of str
        Of each joint's torque: N·m, or N for prismatic joints.
    rms : (n,)
        RMS error, N·m.
    rms_raw : (n,)
        RMS error on the uniform grid, resampled but not filtered.
    rms_moving, rms_at_rest : (n,)
        RMS error of joints in motion, and at rest.
    at_rest : (n,)
        Fraction of the samples at rest.
    torque_rms : (n,)
        RMS of the measured torque.
    relative_rms : (n,)
        ``rms / torque_rms``.
    correlation : (n,)
        Of measured and predicted torque, per joint.
    bias : (n,)
        Mean error.
    noise_floor : (n,)
        RMS error in motion of a model that lacks nothing; see `noise_floor`.
    noise_source : str
        ``period_to_period``, ``motion`` or ``none``; see
        `lieid_casadi.comparison.noise_floor.SOURCES`.
    worst : tuple of LargeError
        Largest errors of each joint, largest first.
    series : tuple of Series
        One per segment.
    cutoff : float
        Of the filter, Hz.
    recordings : tuple of Source
    duration : float
        Compared time, s.
    warnings : tuple of LieidWarning
    """

    joint_names: tuple[str, ...]
    units: tuple[str, ...]
    rms: Array
    rms_raw: Array
    rms_moving: Array
    rms_at_rest: Array
    at_rest: Array
    torque_rms: Array
    relative_rms: Array
    correlation: Array
    bias: Array
    noise_floor: Array
    noise_source: str
    worst: tuple[LargeError, ...]
    series: tuple[Series, ...]
    cutoff: float
    recordings: tuple[Source, ...]
    duration: float
    warnings: tuple[LieidWarning, ...]

    @property
    def n(self) -> int:
        """Number of joints."""
        return len(self.rms)

    @property
    def over_noise(self) -> Array:
        """RMS error in motion in multiples of the noise floor (n,), NaN for joints at rest."""
        with np.errstate(divide="ignore", invalid="ignore"):
            return np.asarray(self.rms_moving / self.noise_floor)

    @property
    def relative_rms_moving(self) -> Array:
        """RMS error relative to the RMS of the measured torque, both in motion (n,)."""
        measured = np.concatenate([s.measured for s in self.series])
        moving = np.concatenate([s.moving for s in self.series])
        squares = np.sum(np.where(moving, measured, 0.0) ** 2, axis=0)
        with np.errstate(divide="ignore", invalid="ignore"):
            torque = np.sqrt(squares / moving.sum(axis=0))
            return np.where(torque > 0.0, self.rms_moving / torque, np.nan)

    @property
    def error_at_rest(self) -> Array:
        """Fraction of the squared error at samples at rest (n,)."""
        at_rest = self.at_rest * np.nan_to_num(self.rms_at_rest) ** 2
        squares = self.rms**2
        return np.divide(at_rest, squares, out=np.zeros_like(squares), where=squares > 0.0)

    @property
    def rest_dominates(self) -> NDArray[np.bool_]:
        """Joints (n,) whose RMS is determined by rest more than by motion."""
        larger = np.nan_to_num(self.rms_at_rest) > np.nan_to_num(self.rms_moving)
        return np.asarray(larger & (self.error_at_rest > REST_MATTERS))

    def to_dict(self) -> dict[str, Any]:
        """Return what ``lieid compare --json`` writes; one number per joint, None for NaN."""
        return {
            "rms": numbers_or_none(self.rms),
            "rms_raw": numbers_or_none(self.rms_raw),
            "rms_moving": numbers_or_none(self.rms_moving),
            "rms_at_rest": numbers_or_none(self.rms_at_rest),
            "at_rest": numbers_or_none(self.at_rest),
            "error_at_rest": numbers_or_none(self.error_at_rest),
            "torque_rms": numbers_or_none(self.torque_rms),
            "relative_rms": numbers_or_none(self.relative_rms),
            "relative_rms_moving": numbers_or_none(self.relative_rms_moving),
            "correlation": numbers_or_none(self.correlation),
            "bias": numbers_or_none(self.bias),
            "noise_floor": numbers_or_none(self.noise_floor),
            "noise_source": self.noise_source,
            "worst": [error.to_dict() for error in self.worst],
            "warnings": warning_list(self.warnings),
            "cutoff": self.cutoff,
            "duration": self.duration,
            "recordings": [r.to_dict() for r in self.recordings],
        }

    def plot(self, ax: Axes | None = None, *, joint: int | None = None) -> Figure:
        """Plot measured torque, predicted torque and error over time; the figure is not shown.

        Parameters
        ----------
        ax : Axes, optional
            Axes for one joint; without, all joints are drawn in a new figure.
        joint : int, optional
            Number of the joint, from 0; the one with the largest relative error if left out and
            ``ax`` is given.
        """
        from lieid_casadi.comparison.torque_plots import plot_joint, plot_torques

        if ax is None and joint is None:
            return plot_torques(self)
        return plot_joint(self, self.worst_joint if joint is None else joint, ax)

    def plot_errors(self) -> Figure:
        """Plot every joint's error over q, q̇, direction, load and time."""
        from lieid_casadi.comparison.error_plots import plot_errors

        return plot_errors(self)

    @property
    def worst_joint(self) -> int:
        """Number, from 0, of the joint with the largest relative error in motion, if any moves."""
        moving = self.relative_rms_moving
        relative = moving if np.isfinite(moving).any() else self.relative_rms
        return int(np.argmax(np.nan_to_num(relative, nan=-1.0)))

    def _repr_html_(self) -> str:
        from lieid_casadi.comparison.table import html_view

        return html_view(self)

    def __repr__(self) -> str:
        pairs = zip(self.rms_moving, self.units, strict=True)
        errors = ", ".join(f"{rms:.3g} {unit}" for rms, unit in pairs)
        return f"<Comparison over {self.duration:.4g} s: RMS error in motion {errors}>"
