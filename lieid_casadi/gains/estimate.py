"""Result: drive gains, how well they are known, and which the motion could not tell."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from lieid_casadi.errors import IdentificationError, LieidWarning
from lieid_casadi.identification.fit import Source, warning_list
from lieid_casadi.robot import Robot

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Array = NDArray[np.float64]
NORMAL = 1.959963984540054  # standard deviations either side that hold 95 %


@dataclass(frozen=True)
class GainNotIdentified:
    """A joint (from 0) whose gain the motion could not tell, and why."""

    joint: int
    reason: str


@dataclass(frozen=True, eq=False)
class DriveGains:
    """Result of :func:`lieid_casadi.drive_gains`. NaN where the motion tells nothing.

    Attributes
    ----------
    robot : Robot
    gains, std : (n,)
        N·m/A (N/A for a sliding joint), and standard deviations.
    covariance : (n, n)
        Of the gains; they share the error of their common scale.
    not_identified : tuple of GainNotIdentified
        Gains without a number, or with one that is little more than noise.
    mass : float
        kg, as given.
    com, com_std : (3,)
        Payload's centre of mass in the tool's frame, m; standard deviation 0 where it was given.
    rms, rms_current : (n,)
        Error in motion, N·m and A.
    relative_rms : (n,)
        Error over the spread of the torque.
    unloaded, loaded : tuple of Source
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

    @property
    def interval(self) -> tuple[Array, Array]:
        """Bounds (n,) that hold each gain with 95 % probability."""
        return self.gains - NORMAL * self.std, self.gains + NORMAL * self.std

    @property
    def option(self) -> str | None:
        """The gains as other commands take them; None where one is not told."""
        if self.not_identified:
            return None
        return "--torque-constants " + ",".join(f"{k:.5g}" for k in self.gains)

    def robot_with_gains(self) -> Robot:
        """Return the robot with these torque constants.

        Raises
        ------
        IdentificationError
            A gain was not told.
        """
        if self.not_identified:
            part = self.not_identified[0]
            raise IdentificationError(
                f"the gain of joint {part.joint + 1} is not told ({part.reason}); a robot needs all"
            )
        joints = tuple(
            replace(joint, torque_constant=float(k))
            for joint, k in zip(self.robot.joints, self.gains, strict=True)
        )
        return replace(self.robot, joints=joints, source=None)

    def table(self) -> list[dict[str, Any]]:
        """Return one row per joint (from 1): gain, std, interval, unit, told."""
        doubtful = {part.joint for part in self.not_identified}
        low, high = self.interval
        return [
            {
                "joint": j + 1,
                "name": joint.name,
                "gain": _number(self.gains[j]),
                "std": _number(self.std[j]),
                "interval": None if np.isnan(self.gains[j]) else [float(low[j]), float(high[j])],
                "unit": "N·m/A" if joint.revolute else "N/A",
                "told": j not in doubtful,
            }
            for j, joint in enumerate(self.robot.joints)
        ]

    def to_dict(self) -> dict[str, Any]:
        """Return what ``lieid gains --json`` writes."""
        return {
            "robot": self.robot.name,
            "effects": list(self.effects),
            "gains": _numbers(self.gains),
            "std": _numbers(self.std),
            "interval_95": [row["interval"] for row in self.table()],
            "units": [row["unit"] for row in self.table()],
            "option": self.option,
            "not_identified": [
                {"joint": part.joint + 1, "reason": part.reason} for part in self.not_identified
            ],
            "mass": self.mass,
            "com": _numbers(self.com),
            "com_std": _numbers(self.com_std),
            "rms": _numbers(self.rms),
            "rms_current": _numbers(self.rms_current),
            "relative_rms": _numbers(self.relative_rms),
            "cutoff": self.cutoff,
            "unloaded": [{"name": r.name, "sha256": r.sha256} for r in self.unloaded],
            "loaded": [{"name": r.name, "sha256": r.sha256} for r in self.loaded],
            "warnings": warning_list(self.warnings),
        }

    def plot(self, ax: Axes | None = None) -> Figure:
        """Draw the gains with their 95 % intervals; return the figure, not shown."""
        from matplotlib.figure import Figure

        if ax is None:
            figure = Figure(figsize=(1.6 + 0.8 * self.robot.n, 3.2), layout="constrained")
            ax = figure.subplots()
        places = np.arange(1, self.robot.n + 1)
        ax.errorbar(places, self.gains, NORMAL * self.std, fmt="o", capsize=4)
        ax.set_xticks(places)
        ax.set_xlabel("joint")
        ax.set_ylabel("drive gain, N·m/A")
        ax.set_ylim(bottom=min(0.0, float(np.nanmin(self.gains, initial=0.0))))
        drawn = ax.get_figure(root=True)
        assert drawn is not None
        return drawn

    def _repr_html_(self) -> str:
        from html import escape

        def cell(value: float | None, digits: int) -> str:
            return "<td>–</td>" if value is None else f"<td>{value:.{digits}g}</td>"

        rows = "".join(
            f"<tr><td>{row['joint']} {escape(row['name'])}{'' if row['told'] else ' (not told)'}"
            f"</td>{cell(row['gain'], 4)}{cell(row['std'], 2)}<td>{row['unit']}</td></tr>"
            for row in self.table()
        )
        head = "<tr><th>joint</th><th>gain</th><th>std</th><th>unit</th></tr>"
        return f"<table>{head}{rows}</table>"

    def __repr__(self) -> str:
        return f"<DriveGains of {self.robot.name}: {', '.join(f'{k:.4g}' for k in self.gains)}>"


def _number(x: float) -> float | None:
    return float(x) if np.isfinite(x) else None


def _numbers(x: Array) -> list[float | None]:
    return [_number(float(each)) for each in x]
