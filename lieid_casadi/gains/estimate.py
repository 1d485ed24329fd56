"""Result: drive gains with standard deviations, and the gains that cannot be identified."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from lieid_casadi.arrays import Array
from lieid_casadi.errors import IdentificationError, LieidWarning, warning_list
from lieid_casadi.identification.recording_checks import Source
from lieid_casadi.json_numbers import number_or_none, numbers_or_none
from lieid_casadi.robot import Drive, Robot
from lieid_casadi.tables import html

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

NORMAL = 1.959963984540054  # standard deviations on either side of a 95 % interval


@dataclass(frozen=True)
class GainNotIdentified:
    """A joint (from 0) whose gain cannot be identified from the recordings, and the reason."""

    joint: int
    reason: str


@dataclass(frozen=True, eq=False)
class DriveGains:
    """Result of :func:`lieid_casadi.drive_gains`; NaN for gains that cannot be identified.

    Attributes
    ----------
    robot : Robot
    effects : tuple of str
        Friction effects that were identified with the gains.
    gains, std : (n,)
        Gains in N·m/A (N/A for a prismatic joint) and their standard deviations.
    covariance : (n, n)
        Covariance of the gains; the error of their common scale correlates them.
    not_identified : tuple of GainNotIdentified
        Gains without a value, or with a standard deviation above 10 % of the value.
    mass : float
        Mass of the payload as given, kg.
    com, com_std : (3,)
        Centre of mass of the payload in the tool frame, m; standard deviation 0 where given.
    rms, rms_current : (n,)
        RMS residual of joints in motion, N·m and A.
    relative_rms : (n,)
        RMS residual divided by the standard deviation of the torque.
    cutoff : float
        Cut-off frequency of the low-pass filter, Hz.
    unloaded, loaded : tuple of Source
        Recordings without and with the payload.
    warnings : tuple of LieidWarning
    per : {"A", "rad"}
        Unit of the drives' signal: current, or position error (the gain is then a stiffness).
    """

    robot: Robot
    effects: tuple[str, ...]
    gains: Array
    std: Array
    covariance: Array
    not_identified: tuple[GainNotIdentified, ...]
    mass: float
    com: Array
    com_std: Array
    rms: Array
    rms_current: Array
    relative_rms: Array
    cutoff: float
    unloaded: tuple[Source, ...]
    loaded: tuple[Source, ...]
    warnings: tuple[LieidWarning, ...]
    per: str = "A"

    @property
    def interval(self) -> tuple[Array, Array]:
        """Bounds (n,) of the 95 % confidence interval of each gain."""
        return self.gains - NORMAL * self.std, self.gains + NORMAL * self.std

    @property
    def option(self) -> str | None:
        """The gains as the option of other commands; None if a gain cannot be identified."""
        if self.not_identified:
            return None
        option = "--torque-constants" if self.per == "A" else "--stiffness"
        return f"{option} " + ",".join(f"{k:.5g}" for k in self.gains)

    def robot_with_gains(self) -> Robot:
        """Return the robot with these torque constants.

        Raises
        ------
        IdentificationError
            A gain cannot be identified.
        """
        if self.not_identified:
            part = self.not_identified[0]
            raise IdentificationError(
                f"the gain of joint {part.joint + 1} cannot be identified ({part.reason}); a robot "
                "needs the torque constants of all joints"
            )
        if self.per == "rad":
            laws = [Drive(stiffness=float(k)) for k in self.gains]
            return replace(self.robot.with_drives(laws), source=None)
        joints = tuple(
            replace(joint, torque_constant=float(k))
            for joint, k in zip(self.robot.joints, self.gains, strict=True)
        )
        return replace(self.robot, joints=joints, source=None)

    def table(self) -> list[dict[str, Any]]:
        """Return one row per joint (from 1): gain, std, interval, unit, identified."""
        weak = {part.joint for part in self.not_identified}
        low, high = self.interval
        return [
            {
                "joint": j + 1,
                "name": joint.name,
                "gain": number_or_none(self.gains[j]),
                "std": number_or_none(self.std[j]),
                "interval": None if np.isnan(self.gains[j]) else [float(low[j]), float(high[j])],
                "unit": f"{'N·m' if joint.revolute else 'N'}/{self.per}",
                "identified": j not in weak,
            }
            for j, joint in enumerate(self.robot.joints)
        ]

    def to_dict(self) -> dict[str, Any]:
        """Return what ``lieid gains --json`` writes."""
        return {
            "robot": self.robot.name,
            "effects": list(self.effects),
            "gains": numbers_or_none(self.gains),
            "std": numbers_or_none(self.std),
            "interval_95": [row["interval"] for row in self.table()],
            "units": [row["unit"] for row in self.table()],
            "option": self.option,
            "not_identified": [
                {"joint": part.joint + 1, "reason": part.reason} for part in self.not_identified
            ],
            "mass": self.mass,
            "com": numbers_or_none(self.com),
            "com_std": numbers_or_none(self.com_std),
            "rms": numbers_or_none(self.rms),
            "rms_current": numbers_or_none(self.rms_current),
            "relative_rms": numbers_or_none(self.relative_rms),
            "cutoff": self.cutoff,
            "unloaded": [r.to_dict() for r in self.unloaded],
            "loaded": [r.to_dict() for r in self.loaded],
            "warnings": warning_list(self.warnings),
        }

    def plot(self, ax: Axes | None = None) -> Figure:
        """Draw the gains with their 95 % intervals and return the figure."""
        from matplotlib.figure import Figure

        if ax is None:
            figure = Figure(figsize=(1.6 + 0.8 * self.robot.n, 3.2), layout="constrained")
            ax = figure.subplots()
        places = np.arange(1, self.robot.n + 1)
        ax.errorbar(places, self.gains, NORMAL * self.std, fmt="o", capsize=4)
        ax.set_xticks(places)
        ax.set_xlabel("joint")
        ax.set_ylabel(f"drive gain, N·m/{self.per}")
        ax.set_ylim(bottom=min(0.0, float(np.nanmin(self.gains, initial=0.0))))
        drawn = ax.get_figure(root=True)
        assert drawn is not None
        return drawn

    def _repr_html_(self) -> str:
        from lieid_casadi.gains.view import gain_table

        return html(gain_table(self))

    def __repr__(self) -> str:
        return f"<DriveGains of {self.robot.name}: {', '.join(f'{k:.4g}' for k in self.gains)}>"
