"""Result of a comparison: errors per joint, worst moments, and the series behind them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from lieid_casadi.comparison.time_series import Series
from lieid_casadi.comparison.worst_moments import Moment
from lieid_casadi.errors import LieidWarning
from lieid_casadi.identification.fit import Source, warning_list

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Array = NDArray[np.float64]
REST_MATTERS = 0.25  # of a joint's squared error


@dataclass(frozen=True, eq=False)
class Comparison:
    """Result of :func:`lieid_casadi.compare`; errors are measured − predicted.

    All of it is of processed signals, measured and predicted through the fit's filter, unless
    called raw. NaN where there is nothing to compute a number from; None in JSON.

    Attributes
    ----------
    joint_names : tuple of str
    units : tuple of str
        Of each joint's torque: N·m, or N where it slides.
    rms : (n,)
        Of the error, N·m.
    rms_raw : (n,)
        Of the error on the uniform grid, resampled but not filtered.
    rms_moving, rms_at_rest : (n,)
        Where the joint moves and where it rests.
    at_rest : (n,)
        Fraction of the samples at rest.
    torque_rms : (n,)
        Of the measured torque itself.
    relative_rms : (n,)
        ``rms / torque_rms``.
    correlation : (n,)
        Of measured and predicted, each joint by itself.
    bias : (n,)
        Mean error.
    noise_floor : (n,)
        Error that a perfect model would have.
    noise_source : str
        ``period_to_period``, ``high_frequency`` (a lower bound) or ``none``.
    worst : tuple of Moment
        Each joint's largest errors, worst first.
    series : tuple of Series
        One per segment.
    cutoff : float
        Of the filter, Hz.
    recordings : tuple of Source
    duration : float
        Of what was compared, s.
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
    worst: tuple[Moment, ...]
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
        """How many times the noise floor the error is (n,)."""
        with np.errstate(divide="ignore", invalid="ignore"):
            return np.asarray(self.rms / self.noise_floor)

    @property
    def error_at_rest(self) -> Array:
        """Fraction of the squared error that samples at rest make (n,)."""
        at_rest = self.at_rest * np.nan_to_num(self.rms_at_rest) ** 2
        squares = self.rms**2
        return np.divide(at_rest, squares, out=np.zeros_like(squares), where=squares > 0.0)

    @property
    def rest_weighs(self) -> NDArray[np.bool_]:
        """Joints (n,) whose RMS says more about rest than about motion."""
        larger = np.nan_to_num(self.rms_at_rest) > np.nan_to_num(self.rms_moving)
        return np.asarray(larger & (self.error_at_rest > REST_MATTERS))

    def to_dict(self) -> dict[str, Any]:
        """Return what ``lieid compare --json`` writes; one number per joint, None for NaN."""
        return {
            "rms": numbers(self.rms),
            "rms_raw": numbers(self.rms_raw),
            "rms_moving": numbers(self.rms_moving),
            "rms_at_rest": numbers(self.rms_at_rest),
            "at_rest": numbers(self.at_rest),
            "error_at_rest": numbers(self.error_at_rest),
            "torque_rms": numbers(self.torque_rms),
            "relative_rms": numbers(self.relative_rms),
            "correlation": numbers(self.correlation),
            "bias": numbers(self.bias),
            "noise_floor": numbers(self.noise_floor),
            "noise_source": self.noise_source,
            "worst": [moment.to_dict() for moment in self.worst],
            "warnings": warning_list(self.warnings),
            "cutoff": self.cutoff,
            "duration": self.duration,
            "recordings": [{"name": r.name, "sha256": r.sha256} for r in self.recordings],
        }

    def plot(self, ax: Axes | None = None, *, joint: int | None = None) -> Figure:
        """Draw measured, predicted and error over time; return the figure, not shown.

        Parameters
        ----------
        ax : Axes, optional
            Draw one joint into it; without, all joints in a new figure.
        joint : int, optional
            From 0; for ``ax``, the joint with the largest relative error if left out.
        """
        from lieid_casadi.comparison.plots import plot_joint, plot_torques

        if ax is None and joint is None:
            return plot_torques(self)
        return plot_joint(self, self.worst_joint if joint is None else joint, ax)

    def plot_errors(self) -> Figure:
        """Draw every joint's error against q, q̇, direction, load and time."""
        from lieid_casadi.comparison.error_plots import plot_errors

        return plot_errors(self)

    @property
    def worst_joint(self) -> int:
        """Joint, from 0, with the largest relative error."""
        return int(np.argmax(np.nan_to_num(self.relative_rms, nan=-1.0)))

    def _repr_html_(self) -> str:
        from lieid_casadi.comparison.table import html_table

        return html_table(self)


def numbers(values: Sequence[float] | Array) -> list[float | None]:
    """Return numbers as JSON knows them: None for what is not finite."""
    return [float(value) if np.isfinite(value) else None for value in values]
