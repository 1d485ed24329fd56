"""Identification of a model's parameters from recordings."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cache
from typing import Any, Literal, get_args

import numpy as np
from numpy.typing import ArrayLike

from lieid_casadi.arrays import Array
from lieid_casadi.blas_threads import blas_on_one_thread
from lieid_casadi.compiled import Compiled, compile
from lieid_casadi.errors import EffectError, IdentificationError, LieidWarning, unique_warnings
from lieid_casadi.identification import fit_warnings
from lieid_casadi.identification.feasible.feasible_fit import (
    ConsistentFit,
    certify,
    make_feasible,
    mass_warnings,
)
from lieid_casadi.identification.fit import Fit
from lieid_casadi.identification.prediction import center_temperature, training_rms
from lieid_casadi.identification.recording_checks import Provenance, Source, check_recordings
from lieid_casadi.identification.regression.cross_validation import (
    Estimate,
    Fold,
    cross_validated_rms,
    fold_factors,
)
from lieid_casadi.identification.regression.design_matrix import Design, FilteredColumns
from lieid_casadi.identification.regression.fixed_point import FitState, Progress, fixed_point
from lieid_casadi.identification.regression.least_squares import conditioning, solve, stacked
from lieid_casadi.identification.uncertainty.covariance import fit_covariance
from lieid_casadi.identification.uncertainty.noise_model import Noise, residual_noise
from lieid_casadi.identification.uncertainty.shape_intervals import open_intervals, shape_intervals
from lieid_casadi.model import Model, as_model
from lieid_casadi.recording import Processed, Processing, Recording, check, process
from lieid_casadi.recording.conversion import is_torque_of_laws
from lieid_casadi.recording.processed import recording_count
from lieid_casadi.recording.recording import listed
from lieid_casadi.robot import Robot

Method = Literal["ols", "wls", "robust", "feasible"]
METHODS: tuple[Method, ...] = get_args(Method)


@blas_on_one_thread
def identify(
    model: Model | Robot,
    recordings: Recording | Sequence[Recording],
    *,
    method: Method = "wls",
    processing: Processing | None = None,
    regularization: float | None = None,
    held_shapes: ArrayLike | None = None,
    progress: Progress | None = None,
) -> Fit:
    """Fit a model's parameters to recordings.

    Parameters
    ----------
    model : Model or Robot
        A robot stands for its model without effects.
    recordings : Recording or sequence of Recording
        With torques. Segments are never joined across a gap.
    method : {"ols", "wls", "robust", "feasible"}
        ``ols``: least squares without weights. ``wls``: each joint weighted by the inverse of its
        noise. ``robust``: further weights against outliers (Huber). ``feasible``: as ``wls``, with
        physically consistent inertias, dissipative friction, and coefficients within their bounds.
    processing : Processing, optional
        Filter options; the cut-off is chosen from the spectrum if not stated.
    regularization : float, optional
        Of the method ``feasible``: weight of the divergence from the nominal bodies, relative to
        the mean squared error in units of the joints' noise; chosen by cross-validation if not
        given.
    held_shapes : (s,), optional
        Values of the shape parameters, NaN for those that the recordings give; shape parameters
        are searched over their whole ranges if left out.
    progress : callable, optional
        Called with a stage's name and the fraction done.

    Returns
    -------
    Fit

    Raises
    ------
    RecordingError
        A recording that is certainly wrong, or without torque.
    ModelError, EffectError, IdentificationError
        Recordings that do not match the model; an unknown method; a negative nominal mass.
    NoSolution
        Method ``feasible`` found no solution; the message says why and what to relax.

    Notes
    -----
    Torque and regressor columns go through the same zero-phase low-pass filter. Shape parameters
    are found by variable projection (Golub, Pereyra, SIAM J. Numer. Anal. 1973). Standard
    deviations account for the correlation of the residual in time (Newey, West, Econometrica
    1987). ``feasible`` requires positive definite pseudo-inertias (Wensing, Kim, Slotine, RA-L
    2018) and is regularized by the entropic divergence from the nominal bodies (Lee, Wensing,
    Park, T-RO 2020).

    Examples
    --------
    >>> import lieid_casadi as lieid, numpy as np
    >>> robot, t = lieid.robots.two_link(), np.arange(0.0, 10.0, 0.01)[:, None]
    >>> q, dq, ddq = np.sin([1, 2] * t), [1, 2] * np.cos([1, 2] * t), [-1, -4] * np.sin([1, 2] * t)
    >>> tau = lieid.compile(lieid.Model(robot)).inverse_dynamics(q, dq, ddq, robot.link_parameters)
    >>> recording = lieid.Recording.from_arrays(t[:, 0], q, dq, tau + 0.5 * dq)
    >>> fit = lieid.identify(lieid.Model(robot, "viscous"), recording)
    >>> fit.effect_coefficients.round(2)
    array([0.5, 0.5])
    """
    model, given = as_model(model), listed(recordings)
    report = progress or (lambda stage, fraction: None)
    _check_method(method, regularization)
    if held_shapes is not None and np.shape(held_shapes) != (len(model.shapes),):
        labels = ", ".join(shape.label for shape in model.shapes) or "no shape parameters"
        raise IdentificationError(
            f"held_shapes has shape {np.shape(held_shapes)}; expected ({len(model.shapes)},), one "
            f"number for each of {labels}"
        )
    compiled, segments, mean, found = _prepared(model, given, processing, report)
    fit = identify_segments(
        compiled,
        segments,
        method=method,
        regularization=regularization,
        held_shapes=None if held_shapes is None else np.asarray(held_shapes, dtype=float),
        temperature_mean=mean,
        provenance=_provenance(given),
        warnings=found,
        report=report,
    ).complete()
    report("done", 1.0)
    return fit


@dataclass(frozen=True, eq=False)
class Estimated:
    """A fit, and the same with its uncertainty, which takes longer than the values.

    Without it the covariance and the training errors are NaN, the residual's noise is white, and
    there is no certificate.
    """

    fit: Fit
    complete: Callable[[], Fit]


def identify_segments(
    compiled: Compiled,
    segments: tuple[Processed, ...],
    *,
    method: Method = "wls",
    temperature_mean: Array | None = None,
    provenance: Provenance | None = None,
    regularization: float | None = None,
    held_shapes: Array | None = None,
    held_out: bool = True,
    known: Sequence[FilteredColumns] | None = None,
    warnings: Sequence[LieidWarning] = (),
    report: Progress = lambda stage, fraction: None,
) -> Estimated:
    """Fit a compiled model to segments that were checked and processed before.

    The one procedure behind `identify`, `extend`, the page and `diagnose`. The result follows from
    the segments, the method and the set of effects alone: not from the order of the effects, nor
    from values known before. Shape parameters are scanned over their whole ranges, each effect
    beside all others, and refined together; the fit is done when neither a small change of all
    shapes nor any other value of one effect's shapes lowers the weighted error (`shape_scan`).

    Temperatures of the segments are relative to ``temperature_mean`` (n,), °C; ``known`` columns
    are shared by fits of models of one robot (`Design`). False for ``held_out`` leaves the
    cross-validated error NaN, for models that are compared with other recordings.
    """
    model, found = compiled.model, list(warnings)
    report("regress", 0.3)
    design = Design(compiled, segments, known=known)
    state, settled = fixed_point(
        design, "wls" if method == "feasible" else method, report, held_shapes
    )
    if not state.rows.lengths.any():
        raise IdentificationError(
            "no joint moves in the recordings: at rest dry friction is undetermined, and with it "
            "all other torques; expected motion"
        )
    least, consistent = state, None
    folds: tuple[Fold, ...] = ()
    if held_out:
        folds = fold_factors(design, state.rows, state.weighting.noise, state.solution.values)
    unweighted = stacked(state.rows)
    found += fit_warnings.of_regression(model, segments, state, unweighted, settled=settled)
    estimate: Estimate = lambda factor: solve(factor).values  # noqa: E731
    if method == "feasible":
        consistent = make_feasible(design, state, folds, regularization, report)
        state, estimate = consistent.state, consistent.estimate
        found += [*consistent.warnings, *mass_warnings(model.robot, state.parameters)]
    found += fit_warnings.bounds(design, least, state)
    report("evaluate", 0.9)
    unknown = np.full(model.n, np.nan)
    fit = Fit(
        model=model, method=method, values=state.solution.values, shapes=state.shapes,
        covariance=np.full((len(state.solution.values) + len(state.shapes),) * 2, np.nan),
        parameters=state.parameters, noise=state.weighting.noise,
        residual_noise=tuple(Noise.white(float(spread)) for spread in state.weighting.noise),
        rms_train=unknown, rms_train_raw=unknown,
        rms_cv=cross_validated_rms(folds, estimate) if folds else unknown,
        processing=segments[0].options, conditioning=conditioning(unweighted, model.base),
        warnings=unique_warnings(found), provenance=provenance or Provenance(_version(), ()),
        temperature_mean=temperature_mean,
    )  # fmt: skip
    return Estimated(fit, cache(lambda: _with_uncertainty(fit, design, least, state, consistent)))


def _with_uncertainty(
    fit: Fit, design: Design, least: FitState, state: FitState, consistent: ConsistentFit | None
) -> Fit:
    """Return a fit with what `Estimated` leaves out.

    ``least`` has the least-squares values, ``state`` those of the fit; they differ if consistent.
    """

    def errors(of: FitState) -> tuple[Array, Array]:
        return training_rms(design.compiled, design.segments, of.parameters, of.shapes)

    (rms, rms_raw), certificate, ends = errors(state), None, None
    if consistent is not None:
        certificate = certify(design, consistent, rms, errors(least)[0])
    covariance = fit_covariance(design, state, with_priors=fit.method != "ols")
    found = [*fit.warnings, *fit_warnings.limits_of_drives(design, least.rows)]
    found += fit_warnings.rough(rms, fit.rms_cv, state.rows)
    if least.scan is not None:
        intervals = shape_intervals(design, least, covariance)
        found += open_intervals(design, least, intervals)
        ends = np.column_stack([intervals.low, intervals.high])
    return replace(
        fit, covariance=covariance, shape_intervals=ends, warnings=unique_warnings(found),
        residual_noise=residual_noise(design.compiled, design.segments, state),
        rms_train=rms, rms_train_raw=rms_raw, certificate=certificate,
    )  # fmt: skip


def _prepared(
    model: Model, given: Sequence[Recording], processing: Processing | None, report: Progress
) -> tuple[Compiled, tuple[Processed, ...], Array | None, list[LieidWarning]]:
    """Return the compiled model, processed segments, mean temperatures (n,), and warnings."""
    check_recordings(model, given)
    compiled = compile(model)
    report("check", 0.0)
    found = [w for recording in given for w in check(recording, model.robot)]
    report("process", 0.1)
    segments, mean = center_temperature(process(given, processing))
    count = recording_count(segments)
    for p in (p for p in model.placements if p.effect.per_recording and p.effect.option):
        if int(p.effect.option) < count:
            raise EffectError(f"{p.label}: found {count} recordings; use {p.effect.name}/{count}")
    found += fit_warnings.relative_torque(model.robot, given)
    found += [*model.robot.warnings, *(w for segment in segments for w in segment.warnings)]
    return compiled, segments, mean, found


def _check_method(method: str, regularization: float | None) -> None:
    if method not in METHODS:
        raise IdentificationError(
            f"unknown method {method!r}; expected one of {', '.join(METHODS)}"
        )
    if regularization is not None and not (method == "feasible" and 0.0 < regularization < np.inf):
        raise IdentificationError(
            f"regularization is {regularization} with method {method!r}; expected a number above 0 "
            "with method='feasible'"
        )


def _provenance(recordings: Sequence[Recording]) -> Provenance:
    """Return where a fit is from, and how its recordings were read if all were read alike."""
    first, read = recordings[0], dict[str, Any]()
    for name in ("torque_constants", "units", "columns", "corrections"):
        if len({getattr(r, name) for r in recordings}) == 1:
            read[name] = getattr(first, name)
    return Provenance(_version(), tuple(Source.of(r) for r in recordings), **read)


def _version() -> str:
    from lieid_casadi import __version__

    return __version__


JOINT_SIDE = ("coulomb", "viscous", "offset")
MOTOR_SIDE = (*JOINT_SIDE, "armature")
COMMANDED = (*MOTOR_SIDE, "command_delay")
ENOUGH_ROWS = 1000  # that show where the torque of a recording comes from


@dataclass(frozen=True)
class DefaultEffects:
    """Effects of a model whose user names none."""

    names: tuple[str, ...]
    reason: str = ""  # why rotor inertia is among them; empty if it is not


def default_effects(
    robot: Robot, recordings: Sequence[Recording], *, motor_side: bool = False
) -> DefaultEffects:
    """Return Coulomb and viscous friction and offset, with rotor inertia for motor-side torque.

    Torque from motor currents or from the control law of position-controlled drives contains the
    torque that accelerates the rotors, which a sensor at the joint does not measure; ``motor_side``
    states it for others. Commands are held until the next one, which is a delay.
    """
    if motor_side:
        return DefaultEffects(MOTOR_SIDE, "torque is measured at the motors")
    if any(recording.torque_constants is not None for recording in recordings):
        return DefaultEffects(MOTOR_SIDE, "torque is computed from motor currents")
    if np.isfinite(robot.torque_constants).any():
        return DefaultEffects(MOTOR_SIDE, "the robot states torque constants of its motors")
    if any(_from_law(robot, recording) for recording in recordings):
        return DefaultEffects(COMMANDED, "torque follows from the control law of the drives")
    return DefaultEffects(JOINT_SIDE)


def _from_law(robot: Robot, recording: Recording) -> bool:
    """Return whether the torque of a recording is that of the robot's control laws."""
    part = recording.rows(0, min(len(recording), ENOUGH_ROWS))
    return robot.drives is not None and is_torque_of_laws(part, robot.drives)
