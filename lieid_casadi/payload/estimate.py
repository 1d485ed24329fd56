"""Result: payload at the tool, its uncertainty, and the quantities that cannot be identified.

Mass, centre of mass and central inertia follow from the parameters m, m·c (3), Ixx, Ixy, Iyy, Ixz,
Iyz, Izz about the origin of the tool frame.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from lieid_casadi.arrays import Array, Mask
from lieid_casadi.comparison.plots import draw_errors
from lieid_casadi.errors import LieidWarning, PayloadMisfitWarning, warning_list
from lieid_casadi.identification.recording_checks import Source
from lieid_casadi.json_numbers import number_or_none, numbers_or_none
from lieid_casadi.plot_style import Axes, Figure
from lieid_casadi.robot.inertia import body_inertia
from lieid_casadi.tables import Table, figures, html, make_table, with_std

NAMES = ("mass", "com_x", "com_y", "com_z", "Ixx", "Ixy", "Iyy", "Ixz", "Iyz", "Izz")
UNITS = ("kg", "m", "m", "m", *("kg·m²",) * 6)
SCALE = np.array([1.0, *(0.1,) * 3, *(0.01,) * 6])  # typical sizes of parameters, for scaling
_ENTRIES = ((0, 0), (0, 1), (1, 1), (0, 2), (1, 2), (2, 2))


def physical_quantities(parameters: Array) -> Array:
    """Return mass, centre of mass (3) and inertia about it (6) as one array (10,)."""
    body = body_inertia(parameters)
    return np.array([body.mass, *body.com, *(body.inertia[i, j] for i, j in _ENTRIES)])


def physical_jacobian(parameters: Array) -> Array:
    """Return the Jacobian (10, 10) of `physical_quantities` at parameters with non-zero mass."""
    m, moment = float(parameters[0]), parameters[1:4]
    jacobian = np.zeros((10, 10))
    jacobian[0, 0] = 1.0
    jacobian[1:4, 0] = -moment / m**2
    jacobian[1:4, 1:4] = np.eye(3) / m
    square = moment @ moment * np.eye(3) - np.outer(moment, moment)
    for row, (i, j) in enumerate(_ENTRIES, start=4):
        jacobian[row, row] = 1.0
        jacobian[row, 0] = square[i, j] / m**2
        for k in range(3):
            # derivative of |mc|²·1 − mc·mcᵀ
            change = 2.0 * moment[k] * (i == j) - (i == k) * moment[j] - (j == k) * moment[i]
            jacobian[row, 1 + k] = -change / m
    return jacobian


#: Parameters (columns) that each physical quantity (rows) depends on: those of a general body
DEPENDS_ON: Mask = physical_jacobian(np.arange(1.0, 11.0)) != 0.0


def identifiable_quantities(hidden: Array) -> Mask:
    """Mark the physical quantities (10,) that can be identified from the data."""
    hidden_parameters = np.abs(hidden).max(axis=0, initial=0.0) > 1e-6
    return np.asarray(~np.any(DEPENDS_ON & hidden_parameters, axis=1))


NORMAL = 1.959963984540054  # standard deviations on either side of a 95 % interval
INSIGNIFICANT = 3.0  # a mass below that many standard deviations is not significant


@dataclass(frozen=True)
class NotIdentified:
    """A quantity that cannot be identified from this recording, and the reason."""

    name: str
    reason: str


@dataclass(frozen=True, eq=False)
class PayloadEstimate:
    """Result of :func:`lieid_casadi.identify_payload`; NaN for quantities not identifiable.

    Mass (kg), centre of mass (3, tool frame, m) and inertia about it (xx, xy, yy, xz, yz, zz, tool
    axes, kg·m²) are estimated by weighted least squares; their standard deviations include the
    fit's own uncertainty.
    """

    robot: str  # name
    frame: str  # where the tool frame lies, to which the values refer
    joint_names: tuple[str, ...]
    values: Array  # (10,) mass, centre of mass, inertia
    std: Array  # (10,) standard deviations
    #: (10,) m, m·c, inertia about the tool frame's origin, and their covariance (10, 10): both zero
    #: along directions that cannot be identified
    parameters: Array
    covariance: Array
    #: Quantities without a value, or with a large relative uncertainty
    not_identified: tuple[NotIdentified, ...]
    #: (n,) RMS error of the loaded run with the fit alone and with the payload, joints in motion,
    #: N·m; NaN for a joint that never moves
    rms_before: Array
    rms_after: Array
    rms_fit: Array  # (n,) held-out error of the fit, N·m: the error to expect
    cutoff: float  # of the low-pass filter, Hz
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
    def mass_std(self) -> float:
        """Standard deviation of the mass, kg."""
        return float(self.std[0])

    @property
    def com_std(self) -> Array:
        """Standard deviations of the centre of mass (3,), m."""
        return self.std[1:4]

    @property
    def _interval(self) -> Array:
        """Bounds (10, 2) of the 95 % confidence interval of each of ``values``."""
        half = NORMAL * self.std
        return np.column_stack([self.values - half, self.values + half])

    @property
    def explained(self) -> bool:
        """Whether a payload explains the run on more than half of the joints."""
        misfits = sum(isinstance(w, PayloadMisfitWarning) for w in self.warnings)
        return 2 * misfits < len(self.joint_names)

    @property
    def sentence(self) -> str:
        """The result in one sentence."""
        if self.explained:
            return self._payload_sentence
        return (
            "A payload does not explain this run: check that it is of this arm, and run lieid "
            "diagnose FIT REC to find what else has changed. Best fit of a payload: "
            f"{self._payload_sentence}"
        )

    @property
    def _payload_sentence(self) -> str:
        m, std = self.mass, self.mass_std
        if not np.isfinite(m):
            return "The mass of the payload cannot be identified from this motion."
        size = f"{with_std(m, std)} kg (one standard deviation)"
        if abs(m) <= INSIGNIFICANT * std:
            return f"No significant payload: {size}."
        if m < 0.0:
            return (
                f"The run carries less than the fit includes: {size}. The fit may have been made "
                "with a load, or a tool may have been removed."
            )
        com = [
            f"{1000 * c:.1f} ± {1000 * s:.1f}" if np.isfinite(c) else "not identified"
            for c, s in zip(self.com, self.com_std, strict=True)
        ]
        return f"Payload {size}, centre of mass at ({', '.join(com)}) mm in the {self.frame}."

    def table(self) -> list[dict[str, Any]]:
        """Return one row per quantity: name, value, std, interval, unit, identified."""
        weak, ends = {part.name for part in self.not_identified}, self._interval
        return [
            {
                "name": name,
                "value": number_or_none(self.values[k]),
                "std": number_or_none(self.std[k]),
                "interval": None if np.isnan(self.values[k]) else ends[k].tolist(),
                "unit": UNITS[k],
                "identified": name not in weak,
            }
            for k, name in enumerate(NAMES)
        ]

    def to_dict(self) -> dict[str, Any]:
        """Return what ``lieid payload --json`` writes."""
        ends = [numbers_or_none(pair) for pair in self._interval]
        return {
            "robot": self.robot,
            "frame": "tool",
            "frame_place": self.frame,
            "verdict": self.sentence,
            "explained": self.explained,
            "mass": number_or_none(self.mass),
            "com": numbers_or_none(self.com),
            "inertia": numbers_or_none(self.values[4:]),
            "std": {
                "mass": number_or_none(self.mass_std),
                "com": numbers_or_none(self.com_std),
                "inertia": numbers_or_none(self.std[4:]),
            },
            "interval_95": {"mass": ends[0], "com": ends[1:4], "inertia": ends[4:]},
            "not_identified": [
                {"name": part.name, "reason": part.reason} for part in self.not_identified
            ],
            "rms_before": numbers_or_none(self.rms_before),
            "rms_after": numbers_or_none(self.rms_after),
            "rms_fit": numbers_or_none(self.rms_fit),
            "cutoff": self.cutoff,
            "recordings": [r.to_dict() for r in self.recordings],
            "warnings": warning_list(self.warnings),
        }

    def plot(self, ax: Axes | None = None) -> Figure:
        """Draw the error of each joint with and without the payload and return the figure."""
        errors, fit = (self.rms_before, self.rms_after), ("the fit's held-out error", self.rms_fit)
        return draw_errors(errors, ("fit alone", "with the payload"), fit, "recordings", ax)

    def _repr_html_(self) -> str:
        reasons = [f"* {names}: {reason}." for names, reason in not_identified(self)]
        return html(self.sentence, quantity_table(self), *reasons)

    def __repr__(self) -> str:
        return f"<PayloadEstimate: {self.sentence}>"


def quantity_table(payload: PayloadEstimate) -> Table:
    """Return mass, centre of mass and inertia; ``*`` marks what is not identified."""
    rows = [
        (
            row["name"] + ("" if row["identified"] else " *"),
            row["value"],
            row["std"],
            *(row["interval"] or (None, None)),
            row["unit"],
        )
        for row in payload.table()
    ]
    return make_table(
        "Payload in the tool frame; inertia about the centre of mass",
        ("", "value", "std", "95 % from", "to", "unit"),
        rows,
    )


def error_table(payload: PayloadEstimate) -> Table:
    """Return the RMS error of each joint with and without the payload."""
    columns = (payload.rms_before, payload.rms_after, payload.rms_fit)
    return make_table(
        f"RMS error in motion, N·m (low-pass {payload.cutoff:.3g} Hz)",
        ("joint", "fit alone", "with the payload", "held-out error of the fit"),
        [
            (f"{j + 1} {name}", *(figures(column[j]) for column in columns))
            for j, name in enumerate(payload.joint_names)
        ],
    )


def not_identified(payload: PayloadEstimate) -> list[tuple[str, str]]:
    """Return the quantities that are not identified, by reason: (names, reason)."""
    by_reason: dict[str, list[str]] = {}
    for part in payload.not_identified:
        by_reason.setdefault(part.reason, []).append(part.name)
    return [(", ".join(names), reason) for reason, names in by_reason.items()]
