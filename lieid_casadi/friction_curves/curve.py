"""Result of the friction extraction: friction over speed and load with standard errors."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from lieid_casadi.arrays import Array
from lieid_casadi.errors import LieidWarning, warning_list
from lieid_casadi.friction_curves.curve_data import CurveData
from lieid_casadi.identification.recording_checks import Source
from lieid_casadi.json_numbers import number_or_none
from lieid_casadi.tables import html

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


@dataclass(frozen=True, eq=False)
class FrictionCurve:
    """Friction torque of one joint: half of forward minus backward torque (Eq. 15).

    It does not contain what differs between the directions (offset, asymmetric friction).

    Attributes
    ----------
    joint : int
        From 0.
    joint_name : str
    unit : str
        Unit of the torque.
    speed : (G,)
        Mean speed of each point, rad/s.
    load : (G,)
        Mean magnitude of the rigid torque, N·m.
    friction : (G,)
        Friction torque, N·m.
    std : (G,)
        Standard error of the friction, N·m.
    count : (G,) int
        Number of pairs of a forward and a backward pass that contribute to each point.
    load_source : str
        ``model`` (the rigid torque) or ``measured`` (the mean of both directions).
    load_error : float
        RMS difference between the mean torque of both directions and the model's rigid torque,
        N·m; NaN without a model.
    cutoff : float
        Cut-off frequency of the low-pass filter, Hz.
    recordings : tuple of Source
    warnings : tuple of LieidWarning
    data : CurveData
        The pairs of instants, from which columns of friction models are averaged.
    """

    joint: int
    joint_name: str
    unit: str
    speed: Array
    load: Array
    friction: Array
    std: Array
    count: NDArray[np.intp]
    load_source: str
    load_error: float
    cutoff: float
    recordings: tuple[Source, ...]
    warnings: tuple[LieidWarning, ...]
    data: CurveData = field(repr=False)

    def __len__(self) -> int:
        return len(self.speed)

    def to_dict(self) -> dict[str, Any]:
        """Return points and provenance for JSON; joints count from 1."""
        return {
            "joint": self.joint + 1,
            "unit": self.unit,
            "points": [
                {
                    "speed": float(speed),
                    "load": float(load),
                    "friction": float(friction),
                    "std": float(std),
                    "count": int(count),
                }
                for speed, load, friction, std, count in zip(
                    self.speed, self.load, self.friction, self.std, self.count, strict=True
                )
            ],
            "load_source": self.load_source,
            "load_error": number_or_none(self.load_error),
            "cutoff": self.cutoff,
            "recordings": [r.to_dict() for r in self.recordings],
            "warnings": warning_list(self.warnings),
        }

    def plot(self, ax: Axes | None = None) -> Figure:
        """Draw friction over speed, coloured by load, and return the figure."""
        from lieid_casadi.friction_curves.plots import plot_curve

        return plot_curve(self, ax)

    def _repr_html_(self) -> str:
        from lieid_casadi.friction_curves.result_tables import curve_table

        return html(curve_table(self))

    def __repr__(self) -> str:
        return (
            f"<FrictionCurve of {self.joint_name}: {len(self)} points, "
            f"{self.speed.min():.3g} to {self.speed.max():.3g} rad/s>"
        )
