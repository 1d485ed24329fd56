"""Identification: a model and recordings become a fit."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from lieid_casadi.blas_threads import blas_on_one_thread
from lieid_casadi.compiled import Compiled, compile
from lieid_casadi.errors import (
    ConvergenceWarning,
    EffectError,
    IdentificationError,
    LieidWarning,
    ModelError,
)
from lieid_casadi.identification import fit_warnings
from lieid_casadi.identification.feasible.certificate import Certificate
from lieid_casadi.identification.feasible.feasible_fit import certify, make_feasible
from lieid_casadi.identification.feasible.options import FeasibleOptions
from lieid_casadi.identification.fit import Fit, Provenance, Source
from lieid_casadi.identification.prediction import predict_recording, training_errors
from lieid_casadi.identification.regression.conditioning import conditioning
from lieid_casadi.identification.regression.design_matrix import Design, JointRows, Rows
from lieid_casadi.identification.regression.fixed_point import (
    ROUNDS,
    Progress,
    ShapeStart,
    State,
    fixed_point,
)
from lieid_casadi.identification.regression.least_squares import (
    Factor,
    combine,
    joint_factors,
    remaining_fraction,
    solve,
)
from lieid_casadi.identification.regression.variable_projection import shape_columns
from lieid_casadi.identification.regression.weights import ESTIMATORS
from lieid_casadi.identification.uncertainty.covariance import hac_covariance
from lieid_casadi.identification.uncertainty.cross_validation import (
    BLOCK_OVER_CUTOFF,
    Estimate,
    Fold,
    cross_validated_rms,
    fold_factors,
)
from lieid_casadi.identification.uncertainty.noise_model import residual_noise
from lieid_casadi.model import Model
from lieid_casadi.recording import (
    Processed,
    Processing,
    Recording,
    RecordingStream,
    check,
    process,
)

Array = NDArray[np.float64]
METHODS = (*ESTIMATORS, "feasible")


@blas_on_one_thread
def identify(
    model: Model,
    recordings: Recording | RecordingStream | Sequence[Recording | RecordingStream],
    *,
    method: str = "wls",
    processing: Processing | None = None,
    feasible: FeasibleOptions | None = None,
    start: ShapeStart | None = None,
    progress: Progress | None = None,
) -> Fit:
    """Fit a model's parameters to recordings.

    Parameters
    ----------
    model : Model
    recordings : Recording, RecordingStream, or sequence of them
        With torques. Segments are never joined across a gap. A stream is read in parts, and
        checked at one place.
    method : {"wls", "ols", "robust", "feasible"}
        Weights by joint noise, none, or Huber's against outliers; or by joint noise with masses
        and inertias that can exist, friction that dissipates, and coefficients within bounds.
    processing : Processing, optional
        Filter options; the cut-off is chosen from the spectrum if not stated.
    feasible : FeasibleOptions, optional
        What is known of masses and centres of mass, for the method ``feasible``.
    start : ShapeStart, optional
        Shape parameters near the solution; searched over their whole range if left out.
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
        Recordings that do not fit the model; an unknown method; a negative nominal mass.
    NoSolution
        Method ``feasible`` found no solution: why, and what to relax.
    """
    if isinstance(recordings, Recording | RecordingStream):
        recordings = [recordings]
    given = list(recordings)
    looked_at = [_sample(recording) for recording in given]
    report = progress or (lambda stage, fraction: None)
    _check_method(method, feasible)
    check_recordings(model, looked_at)
    compiled = compile(model)
    report("check", 0.0)
    found = [w for recording in looked_at for w in check_with_model(compiled, recording)]
    report("process", 0.1)
    segments, mean = center_temperature(process(given, processing))
    report("regress", 0.3)
    design = Design(compiled, segments)
    state, settled = fixed_point(design, "wls" if method == "feasible" else method, report, start)
    folds = _folds(segments, state)
    unweighted = combine(joint_factors(state.rows), np.ones(model.n))
    found += [w for segment in segments for w in segment.warnings]
    found += fit_warnings.aliases(model, remaining_fraction(unweighted))
    found += fit_warnings.hidden(model, state.solution) + fit_warnings.rest(model, segments)
    if not settled:
        found.append(
            ConvergenceWarning(
                f"load and shape parameters had not settled after {ROUNDS} rounds; "
                "leave out an effect with shape parameters, or give more data"
            )
        )
    estimate: Estimate = _least_squares_values
    certificate: Certificate | None = None
    if method == "feasible":
        possible = make_feasible(design, state, folds, feasible or FeasibleOptions(), report)
        rms_wls, _ = _rms(compiled, segments, state)
        state, estimate = possible.state, possible.estimate
        found += possible.warnings
    found += fit_warnings.bounds(model, state)
    report("evaluate", 0.9)
    rms, rms_raw = _rms(compiled, segments, state)
    if method == "feasible":
        certificate = certify(design, possible, rms, rms_wls)
    fit = Fit(
        model=model,
        method=method,
        values=state.solution.values,
        shapes=state.shapes,
        covariance=_covariance(design, state),
        parameters=state.parameters,
        noise=state.weighting.noise,
        residual_noise=residual_noise(compiled, segments, state),
        rms_train=rms,
        rms_train_raw=rms_raw,
        rms_cv=cross_validated_rms(folds, estimate),
        processing=segments[0].options,
        conditioning=conditioning(unweighted, model.base),
        warnings=unique_warnings(found),
        provenance=_provenance(given),
        temperature_mean=mean,
        certificate=certificate,
    )
    report("done", 1.0)
    return fit


def _sample(recording: Recording | RecordingStream) -> Recording:
    """Return the recording, or the middle one of a stream's samples."""
    if isinstance(recording, Recording):
        return recording
    samples = recording.samples()
    return samples[len(samples) // 2]


def _check_method(method: str, feasible: FeasibleOptions | None) -> None:
    if method not in METHODS:
        raise IdentificationError(
            f"unknown method {method!r}; expected one of {', '.join(METHODS)}"
        )
    if feasible is not None and method != "feasible":
        raise IdentificationError(
            f"options of method feasible were given with method {method!r}; "
            "expected method='feasible'"
        )


def check_with_model(compiled: Compiled, recording: Recording) -> tuple[LieidWarning, ...]:
    """Check a recording against the robot, with its nominal torque where inertias are known."""
    robot = compiled.model.robot
    nominal = None
    if robot.has_inertia and recording.tau is not None:
        from lieid_casadi.recording.processing.process import Processing

        nothing = np.concatenate([robot.link_parameters, np.zeros(len(compiled.model.columns))])
        nominal = predict_recording(
            compiled, recording, Processing(cutoff=5.0), nothing, compiled.model.initial_shapes
        )
    return check(recording, robot, nominal_torque=nominal)


def check_recordings(model: Model, recordings: Sequence[Recording]) -> None:
    """Raise where recordings lack what the model needs: joints, torque, temperature."""
    if not recordings:
        raise IdentificationError("no recordings given; expected at least one")
    needs = {s for p in model.placements for s in p.effect.signals}
    for recording in recordings:
        name = recording.name or "recording"
        if recording.n != model.n:
            raise ModelError(
                f"{name}: {recording.n} joints; robot {model.robot.name!r} has {model.n}"
            )
        if recording.tau is None:
            raise ModelError(
                f"{name}: no torque; expected columns tau1…tau{model.n}, "
                "or currents with --torque-constants"
            )
        if "temperature" in needs and recording.temperature is None:
            raise EffectError(f"{name}: an effect needs temperature; expected columns temp1…")


def center_temperature(
    segments: Sequence[Processed], mean: Array | None = None
) -> tuple[tuple[Processed, ...], Array | None]:
    """Refer temperatures to their mean over all segments (or a given one)."""
    if any(segment.temperature is None for segment in segments):
        return tuple(segments), mean
    if mean is None:
        mean = np.concatenate([s.temperature for s in segments if s.temperature is not None]).mean(
            0
        )
    centered = [
        replace(s, temperature=s.temperature - mean) for s in segments if s.temperature is not None
    ]
    return tuple(centered), mean


def _covariance(design: Design, state: State) -> Array:
    """Return the covariance of values and shapes (p + s, p + s)."""
    rows, values = state.rows, state.solution.values
    residuals = rows.residuals(values)
    unit = state.solution.unit_covariance
    if len(state.shapes):
        slopes = shape_columns(design, values, state.shapes, state.parameters)
        rows = _with_columns(rows, slopes)
        weighted = combine(joint_factors(rows, state.weighting.rows), np.ones(design.model.n))
        unit = solve(weighted).unit_covariance
    return hac_covariance(rows, state.weighting.rows, residuals, unit)


def _with_columns(rows: Rows, further: Sequence[Array]) -> Rows:
    """Return rows with further columns after the p base columns."""
    count = rows.count + further[0].shape[1]
    joints = tuple(
        JointRows(
            np.concatenate([joint.columns, np.arange(rows.count, count)]),
            np.column_stack([joint.matrix, extra]),
            joint.torque,
            joint.instant,
        )
        for joint, extra in zip(rows.joints, further, strict=True)
    )
    return Rows(joints, count, rows.segments)


def _rms(compiled: Compiled, segments: Sequence[Processed], state: State) -> tuple[Array, Array]:
    """Return the training error per joint (n,), filtered and as resampled only."""
    squares, counts = np.zeros((2, compiled.n)), np.zeros(2)
    for segment in segments:
        for raw, filtered in training_errors(compiled, segment, state.parameters, state.shapes):
            for k, error in enumerate((filtered, raw)):
                squares[k] += np.sum(error**2, axis=0)
                counts[k] += len(error)
    rms = np.sqrt(squares / counts[:, None])
    return rms[0], rms[1]


def _folds(segments: Sequence[Processed], state: State) -> tuple[Fold, ...]:
    first = segments[0]
    step = first.filtered_time[1] - first.filtered_time[0] if len(first.filtered_time) > 1 else 1.0
    block = max(int(BLOCK_OVER_CUTOFF / first.cutoff / step), 1)
    return fold_factors(state.rows, state.weighting.noise, block=block)


def _least_squares_values(factor: Factor) -> Array:
    return solve(factor).values


def root_mean_square(error: Array) -> Array:
    """Return the RMS of each column."""
    return np.asarray(np.sqrt(np.mean(error**2, axis=0)))


def unique_warnings(found: Sequence[LieidWarning]) -> tuple[LieidWarning, ...]:
    """Return warnings in their order, each once."""
    kept: dict[tuple[type, str], LieidWarning] = {}
    for warning in found:
        kept.setdefault((type(warning), str(warning)), warning)
    return tuple(kept.values())


def _provenance(recordings: Sequence[Recording | RecordingStream]) -> Provenance:
    from lieid_casadi import __version__

    return Provenance(__version__, tuple(Source(r.name, r.source_hash) for r in recordings))
