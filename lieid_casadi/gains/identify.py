"""Drive gains from currents with and without a payload of known mass, with standard deviations."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from lieid_casadi.arrays import Array, Mask
from lieid_casadi.blas_threads import blas_on_one_thread
from lieid_casadi.compiled import compile
from lieid_casadi.effects import Effect
from lieid_casadi.errors import (
    ConvergenceWarning,
    EffectError,
    IdentificationError,
    LieidWarning,
    ModelError,
    unique_warnings,
    warning_list,
)
from lieid_casadi.gains.regression import GainSolution, solve_gains
from lieid_casadi.identification.prediction import center_temperature
from lieid_casadi.identification.recording_checks import Source, check_joints
from lieid_casadi.identification.regression.design_matrix import Design, varying_columns
from lieid_casadi.identification.regression.fixed_point import Progress
from lieid_casadi.json_numbers import number_or_none, numbers_or_none
from lieid_casadi.model import Model
from lieid_casadi.payload.estimate import NORMAL
from lieid_casadi.payload.identify import require_one_load
from lieid_casadi.plot_style import Axes, Figure, drawing
from lieid_casadi.recording import Processing, Recording, check, process
from lieid_casadi.recording.recording import listed
from lieid_casadi.robot import Robot
from lieid_casadi.tables import Table, html, make_table


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
    rms : (n,)
        RMS residual of joints in motion, N·m.
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
    rms: Array
    cutoff: float
    unloaded: tuple[Source, ...]
    loaded: tuple[Source, ...]
    warnings: tuple[LieidWarning, ...]
    per: str = "A"

    @property
    def option(self) -> str | None:
        """The gains as the option of other commands; None if a gain cannot be identified."""
        if self.not_identified:
            return None
        option = "--torque-constants" if self.per == "A" else "--stiffness"
        return f"{option} " + ",".join(f"{k:.5g}" for k in self.gains)

    def table(self) -> list[dict[str, Any]]:
        """Return one row per joint (from 1): gain, std, interval, unit, identified."""
        weak = {part.joint for part in self.not_identified}
        return [
            {
                "joint": j + 1,
                "name": joint.name,
                "gain": number_or_none(gain),
                "std": number_or_none(std),
                "interval": (
                    None if np.isnan(gain) else [gain - NORMAL * std, gain + NORMAL * std]
                ),
                "unit": f"{'N·m' if joint.revolute else 'N'}/{self.per}",
                "identified": j not in weak,
            }
            for j, (joint, gain, std) in enumerate(
                zip(self.robot.joints, self.gains.tolist(), self.std.tolist(), strict=True)
            )
        ]

    def to_dict(self) -> dict[str, Any]:
        """Return what ``lieid gains --json`` writes."""
        rows = self.table()
        arrays = {name: getattr(self, name) for name in ("gains", "std", "rms")}
        return {
            "robot": self.robot.name,
            "effects": list(self.effects),
            **{name: numbers_or_none(values) for name, values in arrays.items()},
            "interval_95": [row["interval"] for row in rows],
            "units": [row["unit"] for row in rows],
            "option": self.option,
            "not_identified": [
                {"joint": part.joint + 1, "reason": part.reason} for part in self.not_identified
            ],
            "mass": self.mass,
            "cutoff": self.cutoff,
            "unloaded": [r.to_dict() for r in self.unloaded],
            "loaded": [r.to_dict() for r in self.loaded],
            "warnings": warning_list(self.warnings),
        }

    def plot(self, ax: Axes | None = None) -> Figure:
        """Draw the gains with their 95 % intervals and return the figure."""
        figure, ax = drawing(ax, 1.6 + 0.8 * self.robot.n, 3.2)
        places = np.arange(1, self.robot.n + 1)
        ax.errorbar(places, self.gains, NORMAL * self.std, fmt="o", capsize=4)
        ax.set_xticks(places)
        ax.set_xlabel("joint")
        ax.set_ylabel(f"drive gain, N·m/{self.per}")
        ax.set_ylim(bottom=min(0.0, float(np.nanmin(self.gains, initial=0.0))))
        return figure

    def _repr_html_(self) -> str:
        return html(gain_table(self))

    def __repr__(self) -> str:
        return f"<DriveGains of {self.robot.name}: {', '.join(f'{k:.4g}' for k in self.gains)}>"


def gain_table(gains: DriveGains) -> Table:
    """Return the gain of each joint; ``*`` marks what is not identified."""
    rows = [
        (
            f"{row['joint']} {row['name']}{'' if row['identified'] else ' *'}",
            row["gain"],
            row["std"],
            None if row["gain"] is None else 100.0 * row["std"] / abs(row["gain"]),
            *(row["interval"] or (None, None)),
            row["unit"],
            float(gains.rms[j]),
        )
        for j, row in enumerate(gains.table())
    ]
    return make_table(
        f"Drive gains from a payload of {gains.mass:g} kg (low-pass {gains.cutoff:.3g} Hz)",
        ("joint", "gain", "std", "std %", "95 % from", "to", "unit", "RMS error, N·m"),
        rows,
    )


LARGEST_MASS = 1e5  # kg: larger payloads are errors of unit


def with_drive_signal(
    empty: Sequence[Recording], full: Sequence[Recording]
) -> tuple[list[Recording], list[Recording], str]:
    """Return the recordings with currents, or the position error in rad, and the signal's unit."""
    every = (*empty, *full)
    if not every or any(r.current is not None or r.command is None for r in every):
        return list(empty), list(full), "A"
    moved = [replace(r, current=r.command - r.q) for r in every if r.command is not None]
    return moved[: len(empty)], moved[len(empty) :], "rad"


def check_input(model: Model, empty: Sequence[Recording], full: Sequence[Recording]) -> None:
    """Raise if effects or recordings are not suitable."""
    varying = np.flatnonzero(varying_columns(model))
    if len(varying):
        raise EffectError(
            f"{model.columns[varying[0]].label}: effects with shape parameters or of the load "
            "cannot be fitted with drive gains; expected coulomb, viscous, offset and others "
            "that follow from the motion"
        )
    for part, recordings in (("unloaded", empty), ("loaded", full)):
        if not recordings:
            raise IdentificationError(f"no {part} recording given; expected at least one")
    for recording in (*empty, *full):
        name = recording.name or "recording"
        check_joints(model, recording)
        if recording.current is None:
            raise ModelError(
                f"{name}: no motor currents; expected columns i1…i{model.n}, or in all recordings "
                f"commanded positions qcmd1…qcmd{model.n}"
            )
        still = np.flatnonzero(np.ptp(recording.current, axis=0) == 0.0)
        if len(still):
            raise IdentificationError(
                f"{name}: the current i{still[0] + 1} is the same in every row "
                f"({recording.current[0, still[0]]:g} A); expected the measured motor current"
            )
    for one in empty:
        for other in full:
            same = bool(one.source_hash) and one.source_hash == other.source_hash
            if same and one.t[0] <= other.t[-1] and other.t[0] <= one.t[-1]:
                raise IdentificationError(
                    f"{other.name or 'recording'}: given as unloaded and as loaded; expected "
                    "different recordings"
                )


WEAK = 0.1  # relative standard deviation above which a gain is reported as not identified
NO_PAYLOAD = 0.3  # the same of every gain: the payload has no visible effect
ANOTHER_ARM = 0.3  # residual over the torque's standard deviation, on more than half of the joints
ZERO = 1e-6  # part of a hidden direction that counts as zero


@blas_on_one_thread
def drive_gains(
    robot: Robot,
    unloaded: Recording | Sequence[Recording],
    loaded: Recording | Sequence[Recording],
    *,
    mass: float,
    effects: str | Iterable[str | Effect] = "coulomb,viscous,offset",
    processing: Processing | None = None,
    progress: Progress | None = None,
) -> DriveGains:
    """Identify the gain of every drive in N·m/A (N·m/rad) from a payload of known mass.

    Gains, base parameters of the arm, friction and the unknown parameters of the payload are
    identified together by maximum likelihood with noisy currents; the known mass determines the
    scale (Gautier, Briot, "Global identification of joint drive gains and dynamic parameters of
    robots", 2014).

    Parameters
    ----------
    robot : Robot
        Only its geometry is used; inertias are not needed.
    unloaded, loaded : Recording or sequence of Recording
        Recordings with motor currents, without and with the payload; the same exciting motions
        in both are best. Of recordings with commanded positions and no currents, the gains are the
        stiffnesses of the position controllers, N·m/rad.
    mass : float
        Mass of the payload, kg.
    effects : str or sequence of str or Effect
        Friction effects of the joints, without shape parameters.
    processing : Processing, optional
        Filter options; by default the cut-off is chosen from the data.
    progress : callable, optional
        Called with the name of a stage and the completed fraction (0 to 1).

    Returns
    -------
    DriveGains

    Raises
    ------
    IdentificationError
        The mass is not positive; a recording is given as unloaded and as loaded; the payload has
        no visible effect; or the recordings are of another arm.
    ModelError, RecordingError, EffectError
        Currents are missing, the number of joints differs, or an effect has shape parameters or
        depends on the load.
    """
    empty, full, per = with_drive_signal(listed(unloaded), listed(loaded))
    if not 0.0 < mass <= LARGEST_MASS:
        raise IdentificationError(
            f"mass of the payload is {mass:g} kg, expected more than 0 and at most "
            f"{LARGEST_MASS:g} kg"
        )
    model = Model(robot, effects)
    report = progress or (lambda stage, fraction: None)
    check_input(model, empty, full)
    # currents in A as torques
    currents = [r.with_torque_constants(np.ones(r.n)) for r in (*empty, *full)]
    found: list[LieidWarning] = [w for r in (*empty, *full) for w in check(r, robot)]
    report("process", 0.2)
    options = process(currents, processing)[0].options
    parts = [process(part, options) for part in (currents[: len(empty)], currents[len(empty) :])]
    for part in parts:
        require_one_load(part)
    segments, _ = center_temperature([*parts[0], *parts[1]])
    found += [w for segment in segments for w in segment.warnings]
    report("regress", 0.4)
    compiled, split = compile(model), len(parts[0])
    solution = solve_gains(
        Design(compiled, segments[:split]), Design(compiled, segments[split:]), mass
    )
    if not any(len(e) for e in solution.residuals):
        raise IdentificationError("no joint moves; expected a motion that excites all joints")
    if not solution.converged:
        found.append(
            ConvergenceWarning("gains and noise levels did not converge; use longer recordings")
        )
    result = replace(_result(model, solution, options, (empty, full)), per=per)
    report("done", 1.0)
    return replace(result, warnings=unique_warnings(found))


def _result(
    model: Model,
    solution: GainSolution,
    options: Processing,
    recordings: tuple[Sequence[Recording], Sequence[Recording]],
) -> DriveGains:
    n, mass = model.n, solution.mass
    gains, std = solution.gains, np.sqrt(np.diag(solution.covariance)[:n])
    rms = np.array([np.sqrt(np.mean(e**2)) if len(e) else np.nan for e in solution.residuals])
    moves = np.array([len(i) > 0 for i in solution.currents])
    size = np.abs(solution.hidden)  # of parameters in directions without information
    involved = np.any(size > ZERO * size.max(axis=1, initial=0.0, keepdims=True), axis=0)
    identifiable = ~involved[:n] & moves
    _require_arm(model, solution, rms, recordings)
    _require_load(gains, std, identifiable, mass)
    return DriveGains(
        robot=model.robot,
        effects=tuple(model.effects),
        gains=np.where(identifiable, gains, np.nan),
        std=np.where(identifiable, std, np.nan),
        covariance=solution.covariance[:n, :n],
        not_identified=_not_identified(gains, std, moves, identifiable),
        mass=mass,
        rms=rms,
        cutoff=float(options.cutoff or np.nan),
        unloaded=tuple(Source.of(r) for r in recordings[0]),
        loaded=tuple(Source.of(r) for r in recordings[1]),
        warnings=(),
    )


def _not_identified(
    gains: Array, std: Array, moves: Mask, identifiable: Mask
) -> tuple[GainNotIdentified, ...]:
    """Return the joints without a gain, or with a weak one, and the reasons."""
    parts = []
    for j in range(len(gains)):
        if not moves[j]:
            reason = "the joint never moves"
        elif not identifiable[j]:
            reason = "its torque is not related to that of the payload"
        elif not std[j] <= WEAK * abs(gains[j]):
            reason = (
                f"standard deviation {100 * std[j] / abs(gains[j]):.0f} % of the gain: the "
                "payload loads this joint too little in this motion"
            )
        else:
            continue
        parts.append(GainNotIdentified(j, reason))
    return tuple(parts)


def _require_load(gains: Array, std: Array, identifiable: Mask, mass: float) -> None:
    """Raise if the payload has no visible effect, or if the runs are exchanged."""
    relative = std[identifiable] / np.abs(gains[identifiable])
    if not len(relative) or np.min(relative) > NO_PAYLOAD:
        raise IdentificationError(
            f"the loaded recordings do not show a payload of {mass:g} kg in comparison with the "
            "unloaded ones (the standard deviation of every gain exceeds 30 %); expected more "
            "motion, or recordings with that payload"
        )
    known = identifiable & (std <= NO_PAYLOAD * np.abs(gains))
    if np.all(gains[known] < 0.0):
        raise IdentificationError(
            "all drive gains are negative: the unloaded and the loaded recordings may be "
            "exchanged, or the signs of the currents reversed"
        )


def _require_arm(
    model: Model,
    solution: GainSolution,
    rms: Array,
    recordings: tuple[Sequence[Recording], Sequence[Recording]],
) -> None:
    """Raise if the model explains too little of the currents."""
    spread = np.array([np.std(i) if len(i) else np.nan for i in solution.currents])
    relative = np.nan_to_num(rms / np.abs(solution.gains * spread), posinf=0.0)
    bad = relative > ANOTHER_ARM
    if bad.sum() > len(bad) // 2:
        j = int(np.argmax(relative))
        names = ", ".join(r.name or "recording" for part in recordings for r in part)
        raise IdentificationError(
            f"{names}: the arm {model.robot.name!r} with one payload does not explain the "
            f"currents (on joint {j + 1} the residual is {100 * relative[j]:.0f} % of the torque's "
            "standard deviation); expected runs of that arm, all loaded ones with the same payload"
        )
