"""Forward simulation of a fit under the torques or commands of recordings, and its result."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any, overload

import numpy as np

from lieid_casadi.arrays import Array
from lieid_casadi.effects.backlash import Backlash
from lieid_casadi.effects.joint_elasticity import JointElasticity
from lieid_casadi.errors import (
    LieidWarning,
    ModelError,
    NotSimulatedWarning,
    RecordingError,
    unique_warnings,
    warning_list,
)
from lieid_casadi.identification.fit import Fit
from lieid_casadi.identification.recording_checks import Source
from lieid_casadi.json_numbers import number_or_none, numbers_or_none
from lieid_casadi.model import Model
from lieid_casadi.plot_style import Axes, Figure, drawing
from lieid_casadi.recording import Recording
from lieid_casadi.recording.recording import listed
from lieid_casadi.simulation.integration import Batch, Input, integrate_batch
from lieid_casadi.simulation.runs import (
    Run,
    input_of,
    motions,
    require_positive_mass_matrix,
    runs_of,
    window_errors,
)
from lieid_casadi.simulation.step import LARGEST, Coordinates, plays_of
from lieid_casadi.tables import Table, html, make_table


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
    rms_whole : (n,)
        RMS error over whole segments that are simulated from their start, rad.
    t : (K,)
        Time of the instants in windows, s.
    q, dq : (K, n)
        Simulated motion, restarted from the measured one at the start of every window.
    recordings : tuple of Source
    warnings : tuple of LieidWarning
    """

    joint_names: tuple[str, ...]
    window: float
    under: str
    windows: int
    drift: Drift
    nominal: Drift | None
    rms_whole: Array
    t: Array
    q: Array
    dq: Array
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
            "recordings": [r.to_dict() for r in self.recordings],
            "warnings": warning_list(self.warnings),
        }

    def plot(self, ax: Axes | None = None) -> Figure:
        """Draw the RMS drift of each joint, and that of the nominal model; return the figure."""
        figure, ax = drawing(ax, 1.8 + 0.9 * len(self.joint_names), 3.4)
        places = np.arange(1, len(self.joint_names) + 1)
        if self.nominal is not None:
            ax.plot(places, np.degrees(self.nominal.rms), "o", mfc="none", label="nominal model")
        ax.errorbar(places, np.degrees(self.drift.rms), np.degrees(self.drift.std), fmt="D",
                    color="black", label="fit")  # fmt: skip
        ax.set(yscale="log", xticks=places, xlabel="joint")
        ax.set_ylabel(f"RMS drift after {self.window:g} s, deg")
        ax.legend(fontsize="small")
        return figure

    def _repr_html_(self) -> str:
        return html(drift_table(self))

    def __repr__(self) -> str:
        degrees = ", ".join(f"{x:.3g}" for x in np.degrees(self.drift.rms))
        return f"<Simulation over {self.window:g} s windows: RMS drift {degrees} deg>"


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
        (f"{j + 1} {name}", *(number_or_none(np.degrees(column[j])) for column in columns))
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


@overload
def simulate(
    fit: Fit,
    recordings: Recording | Sequence[Recording],
    *,
    window: float = ...,
    under: Input | None = ...,
    progress: Callable[[str, float], None] | None = ...,
) -> Simulation: ...


@overload
def simulate(
    fit: Fit | Sequence[Fit], *, batch: Batch, under: Input | None = ..., threads: int | None = ...
) -> tuple[Array, Array]: ...


def simulate(
    fit: Fit | Sequence[Fit],
    recordings: Recording | Sequence[Recording] = (),
    *,
    batch: Batch | None = None,
    window: float = 1.0,
    under: Input | None = None,
    threads: int | None = None,
    progress: Callable[[str, float], None] | None = None,
) -> Simulation | tuple[Array, Array]:
    """Integrate a fit from measured states, under recordings' commands or torques, or a batch.

    Windows follow one another without overlap; each starts at the measured position and
    velocity. The whole of every segment is also simulated from its start. The integrator treats
    drives and viscous friction implicitly and dry friction as a set-valued force that can hold a
    joint (`lieid_casadi.simulation.step`). Links with backlash move apart from their motors, whose
    inertia is the armature, and hit the sides of the play without rebound.

    Motions of a ``batch`` start and are driven as its arrays state, with the temperature of
    training, by the same steps compiled to C that takes several motions per instruction. The first
    call for a model compiles it, which takes seconds; it is kept in the user's cache.

    Parameters
    ----------
    fit : Fit or sequence of Fit
        For the W motions of a batch also one for each, such as ``fit.sample(W)``: of one model,
        with the same plays.
    recordings : Recording or sequence of Recording
        With torques, or with commanded positions if the fit's robot has drives.
    batch : Batch, optional
        In place of recordings.
    window : float
        Length of the windows, s.
    under : {"command", "torque"}, optional
        The input; commands if the fit has a drive law and the recordings have commands.
    threads : int, optional
        For a batch; by default all of the machine.
    progress : callable, optional
        Called with a stage's name and the fraction done.

    Returns
    -------
    Simulation, or positions and velocities of a batch
        Each (T − history + 1, W, n), at the start and the end of each interval; NaN once a motion
        has left every range.

    Raises
    ------
    RecordingError
        No segment has the length of a window.
    ModelError
        The recordings have neither input, or another number of joints; the mass matrix is not
        positive definite; a batch has arrays of other shapes, fits of different models, or
        commands without drives.
    """
    if batch is not None:
        return integrate_batch(fit, batch, under, threads)
    if not isinstance(fit, Fit) or not recordings:
        raise ModelError("expected one fit and recordings, or a batch")
    given, report = listed(recordings), progress or (lambda stage, fraction: None)
    if not (np.isfinite(window) and window > 0.0):
        raise ModelError(f"window is {window} s; expected a length above 0")
    chosen = input_of(fit, given, under)
    runs = [run for recording in given for run in runs_of(fit, recording, window, chosen)]
    if not any(len(run.starts) for run in runs):
        longest = max(r.duration for r in given)
        raise RecordingError(
            f"{given[0].title}: no segment has the length of a window of {window:g} s (the "
            f"recording has {longest:.3g} s); expected a shorter window (--window S)"
        )
    require_positive_mass_matrix(fit, runs)
    segments = [run.segment for run in runs]
    warnings = [w for s in segments for w in (*s.recording.warnings, *s.warnings)]
    report("windows", 0.1)
    parts = [_inside(fit, run) for run in runs]
    t, q, dq, errors = (np.concatenate(part) for part in zip(*parts, strict=True))
    report("whole", 0.7)
    whole = np.concatenate([_whole(fit, run) for run in runs])
    report("done", 1.0)
    return Simulation(
        joint_names=tuple(joint.name for joint in fit.model.robot.joints),
        window=window,
        under=chosen,
        windows=len(errors),
        drift=Drift.of(errors),
        nominal=_nominal_drift(fit, runs),
        rms_whole=np.sqrt(np.mean(whole**2, axis=0)),
        t=t,
        q=q,
        dq=dq,
        recordings=tuple(Source.of(r) for r in given),
        warnings=unique_warnings([*_not_simulated(fit), *warnings]),
    )


def _inside(fit: Fit, run: Run) -> tuple[Array, Array, Array, Array]:
    """Return time, positions and velocities inside of windows, and the errors at their ends."""
    n, d, length, starts = fit.model.n, Coordinates.of(fit).size, run.per_window, run.starts
    path = motions([fit], run, starts)
    inside = path[:-1].transpose(1, 0, 2).reshape(len(starts) * length, -1)
    rows = (starts[:, None] + np.arange(length)).ravel()
    ends = path[-1, :, :n] - run.segment.q[starts + length]
    return run.segment.t[rows], inside[:, :n], inside[:, d : d + n], ends


def _whole(fit: Fit, run: Run) -> Array:
    """Return the errors (K, n) of the motion from the first state of a segment."""
    path = motions([fit], run, np.zeros(1, dtype=int), length=len(run.segment) - 1)
    return np.asarray(path[:, 0, : fit.model.n] - run.segment.q)


def _not_simulated(fit: Fit) -> Iterator[LieidWarning]:
    """Report effects by which links move differently from their motors."""
    simulated = {play.joint for play in plays_of(fit)}
    reasons = {
        JointElasticity: "links move with their motors there",
        Backlash: f"it needs a play of up to {LARGEST:g} rad and the motor's inertia "
        "(effect armature)",
    }
    for kind, why in reasons.items():
        own = [p for p in fit.model.placements if isinstance(p.effect, kind)]
        labels = [p.label for p in own if kind is JointElasticity or p.joint not in simulated]
        if labels:
            text = f"{', '.join(labels)}: not part of the simulation; {why}"
            yield NotSimulatedWarning(text)


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
    return Drift.of(
        np.concatenate([window_errors([nominal], run, run.starts)[:, -1] for run in runs])
    )
