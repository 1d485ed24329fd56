"""Result: what hangs on the tool, how well it is known, and what the motion could not tell."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from lieid_casadi.errors import LieidWarning, PayloadMisfitWarning
from lieid_casadi.identification.fit import Source, warning_list
from lieid_casadi.payload.body import NAMES, UNITS, physical
from lieid_casadi.robot.inertia import pseudo_inertia

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Array = NDArray[np.float64]
NORMAL = 1.959963984540054  # standard deviations either side that hold 95 %
NOTHING = 3.0  # standard deviations of the mass that are still nothing


@dataclass(frozen=True)
class NotIdentified:
    """A quantity that the motion could not tell, and why."""

    name: str
    reason: str


@dataclass(frozen=True, eq=False)
class FeasibleBody:
    """The nearest body that can exist.

    Attributes
    ----------
    parameters : (10,)
        m, m·c, inertia about the tool frame's origin.
    rms_after : (n,)
        Error of the loaded run with it, N·m.
    """

    parameters: Array
    rms_after: Array

    @property
    def mass(self) -> float:
        """Mass, kg."""
        return float(self.parameters[0])

    @property
    def com(self) -> Array:
        """Centre of mass (3,), tool frame, m."""
        return physical(self.parameters)[1:4]

    @property
    def inertia(self) -> Array:
        """xx, xy, yy, xz, yz, zz (6,) about the centre of mass, tool axes, kg·m²."""
        return physical(self.parameters)[4:]

    @property
    def eigenvalues(self) -> Array:
        """Of the pseudo-inertia (4,), all positive."""
        return np.asarray(np.linalg.eigvalsh(pseudo_inertia(self.parameters)))

    def to_dict(self) -> dict[str, Any]:
        """Return it as it stands in JSON."""
        return {
            "mass": self.mass,
            "com": self.com.tolist(),
            "inertia": self.inertia.tolist(),
            "eigenvalues": self.eigenvalues.tolist(),
            "rms_after": _numbers(self.rms_after),
        }


@dataclass(frozen=True)
class FrictionChange:
    """A number of the fit's friction that was left free in the loaded run."""

    name: str
    joint: int
    fitted: float
    change: float
    std: float
    unit: str


@dataclass(frozen=True, eq=False)
class PayloadEstimate:
    """Result of :func:`lieid_casadi.identify_payload`. NaN where the motion tells nothing.

    Attributes
    ----------
    values, std : (10,)
        Mass (kg), centre of mass (3, tool frame, m), inertia about it (xx, xy, yy, xz, yz, zz,
        tool axes, kg·m²) by weighted least squares, and standard deviations that include the
        fit's own uncertainty.
    parameters, covariance : (10,), (10, 10)
        m, m·c, inertia about the tool frame's origin; directions that the motion does not show
        are at zero, without variance.
    feasible : FeasibleBody
    not_identified : tuple of NotIdentified
        Quantities without a number, or with one that is little more than noise.
    rms_before, rms_after : (n,)
        Error of the loaded run by the fit alone and with the payload, joints in motion, N·m;
        NaN for a joint that never moves.
    rms_fit : (n,)
        Held-out error of the fit's own training, N·m: what to expect.
    friction : tuple of FrictionChange
        What was refitted; empty without ``refit_friction``.
    cutoff : float
        Hz.
    """

    robot: str
    joint_names: tuple[str, ...]
    values: Array
    std: Array
    parameters: Array
    covariance: Array
    feasible: FeasibleBody
    not_identified: tuple[NotIdentified, ...]
    rms_before: Array
    rms_after: Array
    rms_fit: Array
    friction: tuple[FrictionChange, ...]
    cutoff: float
    recordings: tuple[Source, ...]
    warnings: tuple[LieidWarning, ...]

    @property
    def mass(self) -> float:
        """Mass, kg."""
        return float(self.values[0])

    @property
    def com(self) -> Array:
        """Centre of mass (3,), tool frame, m."""
        return self.values[1:4]

    @property
    def inertia(self) -> Array:
        """xx, xy, yy, xz, yz, zz (6,) about the centre of mass, tool axes, kg·m²."""
        return self.values[4:]

    @property
    def mass_std(self) -> float:
        """Standard deviation of the mass, kg."""
        return float(self.std[0])

    @property
    def com_std(self) -> Array:
        """Standard deviations of the centre of mass (3,), m."""
        return self.std[1:4]

    @property
    def inertia_std(self) -> Array:
        """Standard deviations of the inertia (6,), kg·m²."""
        return self.std[4:]

    @property
    def interval(self) -> tuple[Array, Array]:
        """Bounds (10,) that hold each of ``values`` with 95 % probability."""
        return self.values - NORMAL * self.std, self.values + NORMAL * self.std

    @property
    def explained(self) -> bool:
        """Whether a payload explains the run on most joints."""
        misfits = sum(isinstance(w, PayloadMisfitWarning) for w in self.warnings)
        return 2 * misfits < len(self.joint_names)

    @property
    def sentence(self) -> str:
        """The answer in words."""
        if self.explained:
            return self._taken_as_payload
        return (
            "A payload does not explain this run: is it this arm, and has nothing else changed? "
            f"Taken as one: {self._taken_as_payload}"
        )

    @property
    def _taken_as_payload(self) -> str:
        m, std = self.mass, self.mass_std
        if not np.isfinite(m):
            return "The motion does not tell the payload's mass."
        size = f"{with_std(m, std)} kg (one standard deviation)"
        if abs(m) <= NOTHING * std:
            return f"No payload can be told from none: {size}."
        if m < 0.0:
            return (
                f"The run carries less than the fit knows of: {size}. Was the fit made with a "
                "load, or has a tool been taken off?"
            )
        com = [
            f"{1000 * c:.1f} ± {1000 * s:.1f}" if np.isfinite(c) else "not told"
            for c, s in zip(self.com, self.com_std, strict=True)
        ]
        return f"Payload {size}, centre of mass at ({', '.join(com)}) mm in the tool's frame."

    def table(self) -> list[dict[str, Any]]:
        """Return one row per quantity: name, value, std, interval, feasible, unit, told."""
        doubtful = {part.name for part in self.not_identified}
        low, high = self.interval
        possible = physical(self.feasible.parameters)
        return [
            {
                "name": name,
                "value": _number(self.values[k]),
                "std": _number(self.std[k]),
                "interval": None if np.isnan(self.values[k]) else [float(low[k]), float(high[k])],
                "feasible": float(possible[k]),
                "unit": UNITS[k],
                "told": name not in doubtful,
            }
            for k, name in enumerate(NAMES)
        ]

    def to_dict(self) -> dict[str, Any]:
        """Return what ``lieid payload --json`` writes."""
        low, high = self.interval
        return {
            "robot": self.robot,
            "frame": "tool",
            "verdict": self.sentence,
            "explained": self.explained,
            "mass": _number(self.mass),
            "com": _numbers(self.com),
            "inertia": _numbers(self.inertia),
            "std": {
                "mass": _number(self.mass_std),
                "com": _numbers(self.com_std),
                "inertia": _numbers(self.inertia_std),
            },
            "interval_95": {
                "mass": _numbers(np.array([low[0], high[0]])),
                "com": [_numbers(pair) for pair in np.column_stack([low, high])[1:4]],
                "inertia": [_numbers(pair) for pair in np.column_stack([low, high])[4:]],
            },
            "feasible": self.feasible.to_dict(),
            "not_identified": [
                {"name": part.name, "reason": part.reason} for part in self.not_identified
            ],
            "rms_before": _numbers(self.rms_before),
            "rms_after": _numbers(self.rms_after),
            "rms_fit": _numbers(self.rms_fit),
            "refit_friction": bool(self.friction),
            "friction": [
                {
                    "name": part.name,
                    "joint": part.joint + 1,
                    "fitted": part.fitted,
                    "change": part.change,
                    "std": part.std,
                    "unit": part.unit,
                }
                for part in self.friction
            ],
            "cutoff": self.cutoff,
            "recordings": [{"name": r.name, "sha256": r.sha256} for r in self.recordings],
            "warnings": warning_list(self.warnings),
        }

    def plot(self, ax: Axes | None = None) -> Figure:
        """Draw each joint's error before and after the payload; return the figure, not shown."""
        from lieid_casadi.payload.view import plot

        return plot(self, ax)

    def _repr_html_(self) -> str:
        from lieid_casadi.payload.view import html

        return html(self)

    def __repr__(self) -> str:
        return f"<PayloadEstimate: {self.sentence}>"


def with_std(value: float, std: float) -> str:
    """Return a value and its standard deviation, both to the second digit of the latter.

    Examples
    --------
    >>> with_std(2.00003, 0.00182)
    '2.0000 ± 0.0018'
    """
    decimals = min(max(1 - math.floor(math.log10(std)), 0), 12) if 0.0 < std < math.inf else 4
    return f"{value:z.{decimals}f} ± {std:.{decimals}f}"


def _number(x: float) -> float | None:
    return float(x) if np.isfinite(x) else None


def _numbers(x: Array) -> list[float | None]:
    return [_number(float(each)) for each in x]
