"""Result: how far a simulated motion leaves the measured one."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from lieid_casadi.arrays import Array
from lieid_casadi.errors import LieidWarning, warning_list
from lieid_casadi.identification.recording_checks import Source
from lieid_casadi.json_numbers import numbers_or_none
from lieid_casadi.tables import html

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


@dataclass(frozen=True, eq=False)
class Drift:
    """Simulated minus measured position at the ends of windows: RMS and 95 % (n,), rad.

    NaN where a simulation left every range, or where there is none.
    """

    rms: Array
    p95: Array

    @classmethod
    def of(cls, errors: Array) -> Drift:
        """Return the drift of errors (W, n)."""
        return cls(np.sqrt(np.mean(errors**2, axis=0)), np.percentile(np.abs(errors), 95.0, axis=0))

    @classmethod
    def unknown(cls, n: int) -> Drift:
        """Return the drift of n joints that were not simulated."""
        return cls(np.full(n, np.nan), np.full(n, np.nan))

    def to_dict(self) -> dict[str, Any]:
        """Return the numbers as JSON holds them."""
        return {"rms": numbers_or_none(self.rms), "p95": numbers_or_none(self.p95)}


@dataclass(frozen=True, eq=False)
class Simulation:
    """Result of :func:`lieid_casadi.simulate`.

    Attributes
    ----------
    joint_names : tuple of str
    window : float
        Length of the windows, s.
    under : {"command", "torque"}
        Input of the simulation.
    drift : Drift
        At the ends of the windows.
    refitted : Drift or None
        The same of the fit's model, identified again from ``refitted_to``.
    without : tuple of (str, Drift)
        The same of the models without one effect of the fit each, identified again.
    rms_whole : (n,)
        RMS error over whole segments that are simulated from their start, rad.
    t : (K,)
        Time of the instants in windows, s.
    q, dq : (K, n)
        Simulated motion, restarted from the measured one at the start of every window.
    refitted_to : tuple of Source
        Recordings from which these models were identified.
    recordings : tuple of Source
    warnings : tuple of LieidWarning
    """

    joint_names: tuple[str, ...]
    window: float
    under: str
    drift: Drift
    refitted: Drift | None
    without: tuple[tuple[str, Drift], ...]
    rms_whole: Array
    t: Array
    q: Array
    dq: Array
    refitted_to: tuple[Source, ...]
    recordings: tuple[Source, ...]
    warnings: tuple[LieidWarning, ...]

    def to_dict(self) -> dict[str, Any]:
        """Return what ``lieid simulate --json`` writes; angles in rad."""
        return {
            "window": self.window,
            "under": self.under,
            "joints": list(self.joint_names),
            **self.drift.to_dict(),
            "rms_whole": numbers_or_none(self.rms_whole),
            "refitted": None if self.refitted is None else self.refitted.to_dict(),
            "without": [{"effect": name, **drift.to_dict()} for name, drift in self.without],
            "refitted_to": [r.to_dict() for r in self.refitted_to],
            "recordings": [r.to_dict() for r in self.recordings],
            "warnings": warning_list(self.warnings),
        }

    def plot(self, ax: Axes | None = None) -> Figure:
        """Draw the RMS drift per joint, with and without each effect, and return the figure."""
        from lieid_casadi.simulation.view import draw

        return draw(self, ax)

    def _repr_html_(self) -> str:
        from lieid_casadi.simulation.view import drift_table

        return html(drift_table(self))

    def __repr__(self) -> str:
        degrees = ", ".join(f"{x:.3g}" for x in np.degrees(self.drift.rms))
        return f"<Simulation over {self.window:g} s windows: RMS drift {degrees} deg>"
