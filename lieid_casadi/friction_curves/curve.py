"""Result of the friction extraction: friction over speed and load, with its uncertainty."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from lieid_casadi.errors import LieidWarning, warning_list
from lieid_casadi.friction_curves.curve_data import CurveData
from lieid_casadi.identification.provenance import Source

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class FrictionCurve:
    """Friction torque of one joint: half the difference of both ways (Eq. 15).

    What differs between the directions (offset, asymmetric friction) is not in it.

    Attributes
    ----------
    joint : int
        From 0.
    joint_name : str
    unit : str
        Of the torque.
    speed : (G,)
        Mean speed of each point, rad/s.
    load : (G,)
        Mean size of the rigid torque, N·m.
    friction : (G,)
        N·m.
    std : (G,)
        Standard error, from the scatter of stretches of the motion.
    count : (G,) int
        Passes to and fro that each point has a part of.
    load_source : str
        ``model`` (the rigid torque) or ``measured`` (the mean of both ways).
    load_error : float
        RMS of the mean of both ways against the model's rigid torque, N·m; NaN without a model.
    cutoff : float
        Hz.
    recordings : tuple of Source
    warnings : tuple of LieidWarning
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
        """Return the points and where they come from; joints from 1."""
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
            "load_error": None if np.isnan(self.load_error) else self.load_error,
            "cutoff": self.cutoff,
            "recordings": [{"name": r.name, "sha256": r.sha256} for r in self.recordings],
            "warnings": warning_list(self.warnings),
        }

    def plot(self, ax: Axes | None = None) -> Figure:
        """Draw friction over speed, coloured by load; return the figure."""
        from lieid_casadi.friction_curves.plots import plot_curve

        return plot_curve(self, ax)

    def _repr_html_(self) -> str:
        rows = "".join(
            f"<tr><td>{v:.3g}</td><td>{load:.3g}</td><td>{f:.4g} ± {s:.2g}</td><td>{n}</td></tr>"
            for v, load, f, s, n in zip(
                self.speed, self.load, self.friction, self.std, self.count, strict=True
            )
        )
        head = f"<th>rad/s</th><th>load, {self.unit}</th><th>friction, {self.unit}</th><th>n</th>"
        return f"<table><thead><tr>{head}</tr></thead><tbody>{rows}</tbody></table>"
