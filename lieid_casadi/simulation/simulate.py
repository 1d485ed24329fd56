"""Forward simulation of a fit under the torques or commands of recordings."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from lieid_casadi.effects.backlash import Backlash
from lieid_casadi.effects.joint_elasticity import JointElasticity
from lieid_casadi.errors import (
    IdentificationError,
    LieidWarning,
    ModelError,
    NoSolution,
    NotSimulatedWarning,
    RecordingError,
    unique_warnings,
)
from lieid_casadi.identification import identify
from lieid_casadi.identification.fit import Fit
from lieid_casadi.identification.recording_checks import Source
from lieid_casadi.identification.regression.fixed_point import ShapeStart
from lieid_casadi.model import Model
from lieid_casadi.recording import Recording
from lieid_casadi.recording.recording import listed
from lieid_casadi.simulation.integrator import Integrator
from lieid_casadi.simulation.play import LARGEST, plays_of
from lieid_casadi.simulation.runs import Input, Run, input_of, require_positive_mass_matrix, runs_of
from lieid_casadi.simulation.simulation import Drift, Simulation


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
    report("windows", 0.1)
    parts = [integrator.windows(run) for run in runs]
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
        drift=Drift.of(np.concatenate([part.end_errors for part in parts])),
        refitted=refitted,
        without=tuple(without),
        rms_whole=np.sqrt(np.mean(whole**2, axis=0)),
        t=np.concatenate([part.t for part in parts]),
        q=np.concatenate([part.q for part in parts]),
        dq=np.concatenate([part.dq for part in parts]),
        refitted_to=tuple(Source.of(r) for r in training) if each_effect else (),
        recordings=tuple(Source.of(r) for r in given),
        warnings=unique_warnings([*_not_simulated(fit), *_warnings(runs)]),
    )


def _not_simulated(fit: Fit) -> list[LieidWarning]:
    """Report effects by which links move differently from their motors."""
    placements, simulated = fit.model.placements, {play.joint for play in plays_of(fit)}
    elastic = [p.label for p in placements if isinstance(p.effect, JointElasticity)]
    massless = [
        p.label for p in placements if isinstance(p.effect, Backlash) and p.joint not in simulated
    ]
    reasons = (
        (elastic, "links move with their motors there"),
        (
            massless,
            f"it needs a play of up to {LARGEST:g} rad and the motor's inertia (effect armature)",
        ),
    )
    return [
        NotSimulatedWarning(f"{', '.join(labels)}: not part of the simulation; {why}")
        for labels, why in reasons
        if labels
    ]


def _warnings(runs: Sequence[Run]) -> list[LieidWarning]:
    return [w for run in runs for w in (*run.segment.recording.warnings, *run.segment.warnings)]


def _drift_without(label: str, fit: Fit, train: Sequence[Recording], runs: Sequence[Run]) -> Drift:
    """Return the drift of the model without an effect, identified again; NaN without a solution.

    ``label``: of the effect; empty for the complete model; ``fit``: with the effect; ``runs``: to
    follow.
    """
    kept = [p for p in fit.model.placements if p.effect.label != label]
    model = Model.of_placements(fit.model.robot, kept)
    values = dict(zip(fit.model.shapes, fit.shapes, strict=True))
    start = ShapeStart(np.array([values[shape] for shape in model.shapes]))
    drives = fit.model.robot.drives
    complete = [r if r.tau is not None or drives is None else r.with_drives(drives) for r in train]
    try:
        refit = identify(model, complete, method="feasible", processing=fit.processing, start=start)
        require_positive_mass_matrix(refit, runs)
    except (NoSolution, IdentificationError, ModelError):
        return Drift.unknown(fit.model.n)
    integrator = Integrator(refit, runs[0].under)
    return Drift.of(np.concatenate([integrator.windows(run).end_errors for run in runs]))
