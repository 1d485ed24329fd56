"""The simulation error beside torque errors: a few windows, and the reason where there are none."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lieid_casadi.errors import LieidError
from lieid_casadi.identification.fit import Fit
from lieid_casadi.recording import Recording
from lieid_casadi.recording.recording import listed
from lieid_casadi.simulation.integrator import Integrator
from lieid_casadi.simulation.runs import input_of, require_positive_mass_matrix, runs_of
from lieid_casadi.simulation.simulation import Drift

WINDOW = 1.0  # s
MOST_WINDOWS = 60


@dataclass(frozen=True, eq=False)
class WindowDrift:
    """How far a simulation leaves the measured motion within short windows.

    Attributes
    ----------
    joint_names : tuple of str
    window : float
        Length of the windows, s.
    under : {"command", "torque", ""}
        Input of the simulation; empty if there is none.
    windows : int
        Number of windows that were simulated.
    drift : Drift
        At the ends of the windows, rad; NaN if there is none.
    reason : str
        Why there is no simulation; empty if there is one.
    """

    joint_names: tuple[str, ...]
    window: float
    under: str
    windows: int
    drift: Drift
    reason: str

    @property
    def degrees(self) -> NDArray[np.float64]:
        """RMS of simulated minus measured position per joint (n,), deg."""
        return np.degrees(self.drift.rms)

    def to_dict(self) -> dict[str, Any]:
        """Return the entry ``simulation`` of ``lieid compare --json``; angles in rad."""
        return {
            "window": self.window,
            "under": self.under,
            "windows": self.windows,
            **self.drift.to_dict(),
            "reason": self.reason,
        }


def window_drift(
    fit: Fit,
    recordings: Recording | Sequence[Recording],
    *,
    window: float = WINDOW,
    most: int = MOST_WINDOWS,
) -> WindowDrift:
    """Simulate a fit over short windows of recordings; a reason takes the place of an error.

    The windows are those of `simulate`, of long recordings every k-th.

    ``window``: length of the windows, s; ``most``: largest number of windows.
    """
    names = tuple(joint.name for joint in fit.model.robot.joints)
    try:
        given = listed(recordings)
        under = input_of(fit, given, None)
        runs = [run for recording in given for run in runs_of(fit, recording, window, under)]
        total = sum(run.windows for run in runs)
        if not total:
            reason = f"no segment of the recordings has the length of a window of {window:g} s"
            return WindowDrift(names, window, "", 0, Drift.unknown(len(names)), reason)
        require_positive_mass_matrix(fit, runs)
        integrator = Integrator(fit, under)
    except LieidError as error:
        return WindowDrift(names, window, "", 0, Drift.unknown(len(names)), str(error))
    every = -(-total // most)
    errors = np.concatenate([integrator.windows(run, every=every).end_errors for run in runs])
    return WindowDrift(names, window, under, len(errors), Drift.of(errors), "")
