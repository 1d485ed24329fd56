"""Forward simulation of a fit under the torques or commands of recordings, and its result."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from lieid_casadi.arrays import Array
from lieid_casadi.effects.backlash import Backlash
from lieid_casadi.effects.joint_elasticity import JointElasticity
from lieid_casadi.errors import (
    IdentificationError,
    LieidError,
    LieidWarning,
    ModelError,
    NoSolution,
    NotSimulatedWarning,
    RecordingError,
    unique_warnings,
    warning_list,
)
from lieid_casadi.identification import identify
from lieid_casadi.identification.fit import Fit
from lieid_casadi.identification.recording_checks import Source
from lieid_casadi.json_numbers import number_or_none, numbers_or_none
from lieid_casadi.model import Model
from lieid_casadi.recording import Recording
from lieid_casadi.recording.recording import listed
from lieid_casadi.simulation.play import LARGEST, plays_of
from lieid_casadi.simulation.runs import (
    Input,
    Integrator,
    Run,
    input_of,
    require_positive_mass_matrix,
    runs_of,
)
from lieid_casadi.tables import Table, html, make_table

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


@dataclass(frozen=True, eq=False)
class Drift:
    """Simulated minus measured position at the ends of windows: RMS and 95 % (n,), rad.

    ``std`` (n,) is the standard error of the RMS over the windows. NaN where a simulation left
    every range, or where there is none.
    """

    rms: Array
    p95: Array
    std: Array

    @classmethod
    def of(cls, errors: Array) -> Drift:
        """Return the drift of errors (W, n)."""
        squares, count = errors**2, len(errors)
        rms = np.sqrt(np.mean(squares, axis=0))
        with np.errstate(divide="ignore", invalid="ignore"):
            std = squares.std(axis=0, ddof=min(1, count - 1)) / (2.0 * rms * np.sqrt(count))
        std = np.where(rms > 0.0, std, rms) if count > 1 else np.full(rms.shape, np.nan)
        return cls(rms, np.percentile(np.abs(errors), 95.0, axis=0), std)

    @classmethod
    def unknown(cls, n: int) -> Drift:
        """Return the drift of n joints that were not simulated."""
        return cls(*np.full((3, n), np.nan))

    def to_dict(self) -> dict[str, Any]:
        """Return the numbers as JSON holds them."""
        return {
            "rms": numbers_or_none(self.rms),
            "p95": numbers_or_none(self.p95),
            "rms_std": numbers_or_none(self.std),
        }


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
    windows : int
        Number of windows.
    drift : Drift
        At the ends of the windows.
    nominal : Drift or None
        The same of the robot's description: stated inertias, no effects; None if it states none.
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
    windows: int
    drift: Drift
    nominal: Drift | None
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
            "windows": self.windows,
            **self.drift.to_dict(),
            "nominal": None if self.nominal is None else self.nominal.to_dict(),
            "rms_whole": numbers_or_none(self.rms_whole),
            "refitted": None if self.refitted is None else self.refitted.to_dict(),
            "without": [{"effect": name, **drift.to_dict()} for name, drift in self.without],
            "refitted_to": [r.to_dict() for r in self.refitted_to],
            "recordings": [r.to_dict() for r in self.recordings],
            "warnings": warning_list(self.warnings),
        }

    def plot(self, ax: Axes | None = None) -> Figure:
        """Draw the RMS drift per joint, with and without each effect, and return the figure."""
        return _draw(self, ax)

    def _repr_html_(self) -> str:
        return html(drift_table(self))

    def __repr__(self) -> str:
        degrees = ", ".join(f"{x:.3g}" for x in np.degrees(self.drift.rms))
        return f"<Simulation over {self.window:g} s windows: RMS drift {degrees} deg>"


WINDOW = 1.0  # s
MOST_WINDOWS = 60


@dataclass(frozen=True, eq=False)
class WindowDrift:
    """How far a simulation leaves the measured motion within short windows."""

    joint_names: tuple[str, ...]
    window: float  # length of the windows, s
    under: str  # input of the simulation: command, torque; empty if there is none
    windows: int  # number of windows that were simulated
    drift: Drift  # at the ends of the windows, rad; NaN if there is none
    reason: str  # why there is no simulation; empty if there is one

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
    """Simulate a fit over windows (s) of recordings; a reason takes the place of an error.

    The windows are those of `simulate`; of more than ``most`` every k-th.
    """
    names = tuple(joint.name for joint in fit.model.robot.joints)
    try:
        given = listed(recordings)
        under = input_of(fit, given, None)
        runs = [run for recording in given for run in runs_of(fit, recording, window, under)]
        total = sum(run.windows for run in runs)
        if not total:
            raise RecordingError(
                f"no segment of the recordings has the length of a window of {window:g} s"
            )
        require_positive_mass_matrix(fit, runs)
        integrator = Integrator(fit, under)
    except LieidError as error:
        return WindowDrift(names, window, "", 0, Drift.unknown(len(names)), str(error))
    every = -(-total // most)
    errors = np.concatenate([integrator.windows(run, every=every).end_errors for run in runs])
    return WindowDrift(names, window, under, len(errors), Drift.of(errors), "")


INPUTS = {"command": "commanded positions", "torque": "torques"}


def drift_table(simulation: Simulation) -> Table:
    """Return the drift of each joint, in degrees."""
    s = simulation
    columns = [s.drift.rms, s.drift.std, s.drift.p95, s.rms_whole]
    headings = ["joint", f"RMS after {s.window:g} s", "±", "95 %", "RMS over whole segments"]
    if s.nominal is not None:
        columns.insert(2, s.nominal.rms)
        headings.insert(3, "nominal model")
    rows = [
        (f"{j + 1} {name}", *(_degrees(column[j]) for column in columns))
        for j, name in enumerate(s.joint_names)
    ]
    plural = "" if s.windows == 1 else "s"
    return make_table(
        f"Simulated − measured position, deg, under the recorded {INPUTS[s.under]}: "
        f"{s.windows} window{plural}",
        headings,
        rows,
        note="after a window from a measured state, with its standard error over the windows; the "
        "nominal model has the stated inertias and no effects; whole segments from their first "
        "state",
    )


def window_table(drift: WindowDrift) -> Table:
    """Return the drift of each joint within short windows, in degrees; empty if there is none."""
    rows = [
        (f"{j + 1} {name}", _degrees(rms), _degrees(p95))
        for j, (name, rms, p95) in enumerate(
            zip(drift.joint_names, drift.drift.rms, drift.drift.p95, strict=True)
        )
    ]
    return make_table(
        f"Simulated − measured position, deg, {drift.window:g} s after a measured state",
        ("joint", "RMS", "95 %"),
        () if drift.reason else rows,
        note=f"{drift.windows} windows under the recorded {INPUTS.get(drift.under, '')}; more by "
        "lieid simulate",
    )


def effects_table(simulation: Simulation) -> Table:
    """Return the drift of each joint of the models without one effect of the fit, in degrees."""
    s = simulation
    trained = ", ".join(r.name or "recording" for r in s.refitted_to)
    rows = [
        (name, *(_degrees(angle) for angle in drift.rms))
        for name, drift in (("none", s.refitted or s.drift), *s.without)
    ]
    return make_table(
        f"RMS after {s.window:g} s, deg, of models without one effect, identified from {trained}",
        ("without", *(f"joint {j + 1}" for j in range(len(s.joint_names)))),
        rows if s.without else (),
        note="–: no physically consistent model, or its motion left every range",
    )


def _degrees(angle: float) -> float | None:
    return number_or_none(np.degrees(angle))


def _draw(s: Simulation, ax: Axes | None) -> Figure:
    from matplotlib.figure import Figure

    if ax is None:
        ax = Figure(figsize=(1.8 + 0.9 * len(s.joint_names), 3.4), layout="constrained").subplots()
    places = np.arange(1, len(s.joint_names) + 1)
    for k, (name, drift) in enumerate(s.without):
        ax.plot(places, np.degrees(drift.rms), "o", mfc="none", color=f"C{k + 1}",
                label=f"without {name}")  # fmt: skip
    ax.plot(places, np.degrees(s.drift.rms), "D", color="black", label="model")
    ax.set_yscale("log")
    ax.set_xticks(places)
    ax.set_xlabel("joint")
    ax.set_ylabel(f"RMS drift after {s.window:g} s, deg")
    ax.legend(fontsize="small")
    drawn = ax.get_figure(root=True)
    assert drawn is not None
    return drawn


def simulate(
    fit: Fit,
    recordings: Recording | Sequence[Recording],
    *,
    window: float = 1.0,
    under: Input | None = None,
    each_effect: bool = True,
    train: Recording | Sequence[Recording] | None = None,
    progress: Callable[[str, float], None] | None = None,
) -> Simulation:
    """Integrate a fit from measured states, under the recordings' commands or torques.

    Windows follow one another without overlap; each starts at the measured position and
    velocity. The whole of every segment is also simulated from its start. The integrator treats
    drives and viscous friction implicitly and dry friction as a set-valued force that can hold a
    joint (`lieid_casadi.simulation.step`). Links with backlash move apart from their motors, whose
    inertia is the armature, and hit the sides of the play without rebound.

    Parameters
    ----------
    fit : Fit
    recordings : Recording or sequence of Recording
        With torques, or with commanded positions if the fit's robot has drives.
    window : float
        Length of the windows, s.
    under : {"command", "torque"}, optional
        The input; commands if the fit has a drive law and the recordings have commands.
    each_effect : bool
        Whether to repeat the windows with models that lack one effect of the fit each.
    train : Recording or sequence of Recording, optional
        From which these models, and the complete one, are identified by the method ``feasible``;
        the simulated recordings if left out.
    progress : callable, optional
        Called with a stage's name and the fraction done.

    Returns
    -------
    Simulation

    Raises
    ------
    RecordingError
        No segment has the length of a window.
    ModelError
        The recordings have neither input, or another number of joints; the mass matrix is not
        positive definite.
    """
    given, report = listed(recordings), progress or (lambda stage, fraction: None)
    if not (np.isfinite(window) and window > 0.0):
        raise ModelError(f"window is {window} s; expected a length above 0")
    chosen = input_of(fit, given, under)
    runs = [run for recording in given for run in runs_of(fit, recording, window, chosen)]
    if not any(run.windows for run in runs):
        longest = max(r.duration for r in given)
        raise RecordingError(
            f"{given[0].title}: no segment has the length of a window of {window:g} s (the "
            f"recording has {longest:.3g} s); expected a shorter window (--window S)"
        )
    require_positive_mass_matrix(fit, runs)
    integrator = Integrator(fit, chosen)
    segments = [run.segment for run in runs]
    warnings = [w for s in segments for w in (*s.recording.warnings, *s.warnings)]
    report("windows", 0.1)
    parts = [integrator.windows(run) for run in runs]
    errors = np.concatenate([part.end_errors for part in parts])
    without = []
    labels = sorted({p.effect.label for p in fit.model.placements}) if each_effect else []
    training = given if train is None else listed(train)
    refitted = _drift_without("", fit, training, runs) if labels else None
    for k, label in enumerate(labels):
        report(f"without {label}", 0.2 + 0.5 * k / len(labels))
        without.append((label, _drift_without(label, fit, training, runs)))
    report("whole", 0.7)
    whole = np.concatenate([integrator.whole(run) for run in runs])
    report("done", 1.0)
    return Simulation(
        joint_names=tuple(joint.name for joint in fit.model.robot.joints),
        window=window,
        under=chosen,
        windows=len(errors),
        drift=Drift.of(errors),
        nominal=_nominal_drift(fit, runs),
        refitted=refitted,
        without=tuple(without),
        rms_whole=np.sqrt(np.mean(whole**2, axis=0)),
        t=np.concatenate([part.t for part in parts]),
        q=np.concatenate([part.q for part in parts]),
        dq=np.concatenate([part.dq for part in parts]),
        refitted_to=tuple(Source.of(r) for r in training) if each_effect else (),
        recordings=tuple(Source.of(r) for r in given),
        warnings=unique_warnings([*_not_simulated(fit), *warnings]),
    )


def _not_simulated(fit: Fit) -> list[LieidWarning]:
    """Report effects by which links move differently from their motors."""
    simulated = {play.joint for play in plays_of(fit)}
    reasons = {
        JointElasticity: "links move with their motors there",
        Backlash: f"it needs a play of up to {LARGEST:g} rad and the motor's inertia "
        "(effect armature)",
    }
    found: list[LieidWarning] = []
    for kind, why in reasons.items():
        own = [p for p in fit.model.placements if isinstance(p.effect, kind)]
        labels = [p.label for p in own if kind is JointElasticity or p.joint not in simulated]
        if labels:
            text = f"{', '.join(labels)}: not part of the simulation; {why}"
            found.append(NotSimulatedWarning(text))
    return found


def _nominal_drift(fit: Fit, runs: Sequence[Run]) -> Drift | None:
    """Return the drift of the robot's description, whose inertias may not be stated."""
    robot = fit.model.robot
    if not robot.has_inertia:
        return None
    links = np.asarray(robot.link_parameters)
    model = Model.of_placements(robot, [])
    nominal = replace(
        fit,
        model=model,
        parameters=links,
        values=model.base.combination @ links,
        shapes=np.zeros(0),
    )
    try:
        require_positive_mass_matrix(nominal, runs)
    except ModelError:
        return Drift.unknown(robot.n)
    integrator = Integrator(nominal, runs[0].under)
    return Drift.of(np.concatenate([integrator.windows(run).end_errors for run in runs]))


def _drift_without(label: str, fit: Fit, train: Sequence[Recording], runs: Sequence[Run]) -> Drift:
    """Return the drift of the model without an effect, identified again; NaN without a solution.

    An empty label stands for the complete model.
    """
    kept = [p for p in fit.model.placements if p.effect.label != label]
    model = Model.of_placements(fit.model.robot, kept)
    drives = fit.model.robot.drives
    complete = [r if r.tau is not None or drives is None else r.with_drives(drives) for r in train]
    try:
        refit = identify(model, complete, method="feasible", processing=fit.processing)
        require_positive_mass_matrix(refit, runs)
    except (NoSolution, IdentificationError, ModelError):
        return Drift.unknown(fit.model.n)
    integrator = Integrator(refit, runs[0].under)
    return Drift.of(np.concatenate([integrator.windows(run).end_errors for run in runs]))
