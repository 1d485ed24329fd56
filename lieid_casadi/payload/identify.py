"""Identify a payload from a fit without it and a run with it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lieid_casadi.arrays import Array
from lieid_casadi.blas_threads import blas_on_one_thread
from lieid_casadi.errors import IdentificationError, LieidWarning, unique_warnings
from lieid_casadi.identification import Fit
from lieid_casadi.identification.prediction import center_temperature, predict_recording
from lieid_casadi.identification.recording_checks import (
    Source,
    check_recordings,
    check_torque_constants,
)
from lieid_casadi.identification.regression.design_matrix import Design
from lieid_casadi.identification.regression.fixed_point import Progress
from lieid_casadi.payload import payload_warnings
from lieid_casadi.payload.body import (
    FeasibleBody,
    identifiable_quantities,
    physical_jacobian,
    physical_quantities,
)
from lieid_casadi.payload.estimate import FrictionChange, PayloadEstimate
from lieid_casadi.payload.feasible_body import SCALE, nearest_feasible_body
from lieid_casadi.payload.regression import LoadedRun, LoadedRunEstimate
from lieid_casadi.recording import Processed, Recording, check, process
from lieid_casadi.recording.recording import listed
from lieid_casadi.robot.robot import Robot

ROUNDING = 1e-10  # least variance relative to the sum of its terms before cancellation
REFITTED = ("coulomb", "viscous", "offset")  # effects that change with temperature and wear


@blas_on_one_thread
def identify_payload(
    fit: Fit,
    recordings: Recording | Sequence[Recording],
    *,
    cutoff: float | None = None,
    refit_friction: bool = False,
    torque_constant_std: float | ArrayLike = 0.0,
    progress: Progress | None = None,
) -> PayloadEstimate:
    """Identify a payload at the tool that a fit does not include.

    The difference between the measured torque and the fit's prediction is regressed on the
    columns of a body at the tool, both through the fit's filter, while the parameters of the fit
    may move within their uncertainty. Load-dependent friction accounts for the payload.

    Parameters
    ----------
    fit : Fit
        Identified without the payload, by any method.
    recordings : Recording or sequence of Recording
        Recordings with the payload, with torques.
    cutoff : float, optional
        Cut-off frequency of the low-pass filter, Hz; that of the fit if not given.
    refit_friction : bool
        Whether Coulomb friction, viscous friction and offsets are identified again from this
        run, for an arm whose temperature differs from that of the fit.
    torque_constant_std : float or (n,)
        Relative standard deviation of the torque constants: of an error that all joints share,
        or of independent errors of each joint.
    progress : callable, optional
        Called with the name of a stage and the completed fraction (0 to 1).

    Returns
    -------
    PayloadEstimate

    Raises
    ------
    ModelError, EffectError, RecordingError
        The recordings do not match the model.
    IdentificationError
        No joint moves, there is no friction to refit, or no payload explains the run, which is
        then of another arm.
    NoSolution
        The solver did not find a physically consistent body.

    Notes
    -----
    Khalil, Gautier, Lemoine, "Identification of the payload inertial parameters of industrial
    manipulators", ICRA 2007. The mass scales with the torque constants where torques come from
    motor currents.
    """
    given = listed(recordings)
    report = progress or (lambda stage, fraction: None)
    check_recordings(fit.model, given)
    report("check", 0.0)
    for recording in given:
        check(recording, fit.model.robot)  # raises here; warnings need the torque with the payload
    found = payload_warnings.fit_warnings(fit, given)
    found += [w for r in given for w in check_torque_constants(fit.provenance, r)]
    report("process", 0.2)
    segments = _segments(fit, given, cutoff)
    run = LoadedRun(fit, Design(fit.compiled, segments))
    _require_motion(run)
    frictional = np.array([name in REFITTED for name in run.names])
    if refit_friction and not frictional.any():
        raise IdentificationError(
            f"no friction to refit: the fit of {fit.model.robot.name!r} has none of "
            f"{', '.join(REFITTED)}; leave out --refit-friction"
        )
    report("regress", 0.4)
    kept = run.estimate(np.zeros_like(frictional))
    refitted = run.estimate(frictional) if frictional.any() else kept
    estimate = refitted if refit_friction else kept
    if len(estimate.hidden) >= len(estimate.parameters):
        raise IdentificationError(
            f"{given[0].name or 'the recordings'}: no parameter of a payload can be identified "
            "from this motion with this fit; expected a motion of several joints, in both"
        )
    payload_warnings.require_same_arm(fit, estimate, run)
    nominal = run.loaded_parameters(estimate.parameters)
    found += [w for recording in given for w in _checked(fit, recording, nominal)]
    if not refit_friction:
        found += payload_warnings.changed_friction(run, kept, refitted, frictional)
    report("feasible body", 0.8)
    estimate = _with_uncertain_constants(fit, estimate, torque_constant_std)
    result = _result(fit, run, estimate, frictional if refit_friction else None)
    result = replace(
        result,
        from_currents=_from_currents(fit, given),
        torque_constant_std=_std_of_constants(fit, torque_constant_std),
    )
    found += [w for segment in segments for w in segment.warnings]
    found += payload_warnings.payload_warnings(fit, result, estimate)
    report("done", 1.0)
    return replace(
        result,
        recordings=tuple(Source.of(r) for r in given),
        warnings=unique_warnings(found),
    )


def _segments(
    fit: Fit, recordings: Sequence[Recording], cutoff: float | None
) -> tuple[Processed, ...]:
    """Return the recordings through the fit's filter; refuses those with several payloads."""
    options = replace(
        fit.processing,
        average_periods=False,
        cutoff=fit.processing.cutoff if cutoff is None else cutoff,
    )
    segments, _ = center_temperature(process(recordings, options), fit.temperature_mean)
    require_one_load(segments)
    return segments


def _from_currents(fit: Fit, recordings: Sequence[Recording]) -> bool:
    """Whether torque comes from motor currents: by constants, or by a fit with rotor inertia."""
    return (
        any(recording.torque_constants is not None for recording in recordings)
        or bool(np.isfinite(fit.model.robot.torque_constants).any())
        or any(placement.effect.name == "armature" for placement in fit.model.placements)
    )


def _std_of_constants(fit: Fit, std: float | ArrayLike) -> tuple[float, ...]:
    """Return relative standard deviations: one for all joints, or one per joint.

    Raises `IdentificationError`.
    """
    values = np.atleast_1d(np.asarray(std, dtype=np.float64))
    sizes = (1, fit.model.n)
    if values.ndim != 1 or len(values) not in sizes or not np.all((values >= 0) & (values < 1)):
        raise IdentificationError(
            f"standard deviations of torque constants: found {np.round(values, 6).tolist()}; "
            f"expected one or {fit.model.n} numbers from 0 to 1, relative to the constants"
        )
    return tuple(values.tolist())


def _with_uncertain_constants(
    fit: Fit, estimate: LoadedRunEstimate, std: float | ArrayLike
) -> LoadedRunEstimate:
    """Return the estimate with the covariance that uncertain torque constants add."""
    sizes = np.array(_std_of_constants(fit, std))
    if not sizes.any():
        return estimate
    shared = len(sizes) == 1
    slopes = estimate.parameters[None] if shared else estimate.by_joint
    added = (sizes[:, None] * slopes).T @ (sizes[:, None] * slopes)
    return replace(estimate, covariance=estimate.covariance + added)


def _checked(fit: Fit, recording: Recording, parameters: Array) -> tuple[LieidWarning, ...]:
    """Check a recording against the rigid torque of the arm with the payload."""
    rigid = parameters.copy()
    rigid[10 * fit.model.n :] = 0.0
    torque = predict_recording(
        fit.compiled, recording, fit.processing, rigid, fit.shapes, fit.temperature_mean
    )
    return check(recording, fit.model.robot, nominal_torque=torque)


def require_one_load(segments: Sequence[Processed]) -> None:
    """Raise if the column ``load`` contains several payloads.

    Raises `IdentificationError`.
    """
    labels = list(dict.fromkeys(s.payload_label for s in segments if s.payload_label is not None))
    if len(labels) > 1:
        name = segments[0].recording.name or "the recordings"
        raise IdentificationError(
            f"{name}: column load contains {len(labels)} payloads ({', '.join(labels[:4])}); "
            "expected one; select the part with it as REC@T0:T1"
        )


def _frame(robot: Robot) -> str:
    """Return where the tool frame lies in the last link, which the description names."""
    link = robot.joints[-1].link_name or f"of joint {robot.n}"
    x, y, z = 1000.0 * robot.tool[:3, 3]
    turned = "" if np.allclose(robot.tool[:3, :3], np.eye(3), atol=1e-9) else ", turned"
    return f"tool frame, at ({x:z.0f}, {y:z.0f}, {z:z.0f}) mm in link {link}{turned}"


def _require_motion(run: LoadedRun) -> None:
    rows = run.design.rows(run.fit.shapes, run.fit.parameters)
    if not rows.lengths.any():
        raise IdentificationError(
            "no joint moves in the loaded run; expected a motion like that of the fit's training"
        )


def _result(
    fit: Fit, run: LoadedRun, estimate: LoadedRunEstimate, refitted: NDArray[np.bool_] | None
) -> PayloadEstimate:
    hidden = estimate.hidden / SCALE
    hidden = hidden / np.maximum(np.abs(hidden).max(axis=1, keepdims=True), 1e-300)
    identifiable = identifiable_quantities(hidden)
    values, std = physical_quantities(estimate.parameters), np.full(10, np.nan)
    if estimate.parameters[0] != 0.0:
        std = _propagated(physical_jacobian(estimate.parameters), estimate.covariance)
    else:
        identifiable[:] = False
    not_identified = payload_warnings.not_identified(values, std, identifiable, hidden)
    unknown = ~identifiable | payload_warnings.too_uncertain(values, std)
    body = nearest_feasible_body(estimate.parameters, estimate.covariance, estimate.hidden)
    feasible_errors = run.errors(body, refitted, estimate.free)
    return PayloadEstimate(
        robot=fit.model.robot.name,
        frame=_frame(fit.model.robot),
        joint_names=tuple(joint.name for joint in fit.model.robot.joints),
        values=np.where(unknown, np.nan, values),
        std=np.where(unknown, np.nan, std),
        parameters=estimate.parameters,
        covariance=estimate.covariance,
        feasible=FeasibleBody(body, payload_warnings.rms(feasible_errors)),
        not_identified=not_identified,
        rms_before=payload_warnings.rms(estimate.before),
        rms_after=payload_warnings.rms(estimate.after),
        rms_fit=np.where(np.isfinite(fit.rms_cv), fit.rms_cv, fit.noise),
        friction=() if refitted is None else _friction(run, refitted, estimate),
        cutoff=run.design.segments[0].cutoff,
        recordings=(),
        warnings=(),
    )


def _propagated(jacobian: Array, covariance: Array) -> Array:
    """Return standard deviations of linear functions, bounded below by rounding errors."""
    variance = np.einsum("ij,jk,ik->i", jacobian, covariance, jacobian)
    uncorrelated = jacobian**2 @ np.diag(covariance)
    return np.asarray(np.sqrt(np.maximum(variance, ROUNDING * uncorrelated)))


def _friction(
    run: LoadedRun, refitted: NDArray[np.bool_], estimate: LoadedRunEstimate
) -> tuple[FrictionChange, ...]:
    fit, free = run.fit, np.flatnonzero(refitted | run.drifting)
    found = []
    for k, change, std in zip(free, estimate.free, estimate.free_std, strict=True):
        p = fit.model.base_columns[k]
        if refitted[k]:
            found.append(
                FrictionChange(
                    p.name, p.joint, float(fit.values[k]), float(change), float(std), p.unit
                )
            )
    return tuple(found)
