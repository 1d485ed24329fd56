"""Identify a payload from a fit without it and a run with it, and warn of contradictions."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from lieid_casadi.arrays import Array, Mask
from lieid_casadi.blas_threads import blas_on_one_thread
from lieid_casadi.errors import (
    ConvergenceWarning,
    FrictionChangedWarning,
    IdentificationError,
    LieidWarning,
    NegativeMassWarning,
    PayloadMisfitWarning,
    SameRecordingWarning,
    unique_warnings,
)
from lieid_casadi.identification import Fit, recording_checks
from lieid_casadi.identification.prediction import center_temperature
from lieid_casadi.identification.regression.design_matrix import Design
from lieid_casadi.identification.regression.fixed_point import Progress
from lieid_casadi.identification.regression.least_squares import name_direction
from lieid_casadi.payload import body
from lieid_casadi.payload.estimate import (
    INSIGNIFICANT,
    NotIdentified,
    PayloadEstimate,
)
from lieid_casadi.payload.regression import LoadedRun, LoadedRunEstimate
from lieid_casadi.recording import Processed, Recording, check, process
from lieid_casadi.recording.recording import listed
from lieid_casadi.robot.inertia import LINK_PARAMETER_NAMES
from lieid_casadi.robot.robot import Robot
from lieid_casadi.tables import with_std

WEAK = 0.3  # relative standard deviation above which a quantity is reported as not identified
MASS = 0.05  # kg: a mass with this standard deviation is reported however small it is
LENGTH = 0.02  # m: the same for the centre of mass
MISFIT = 2.0  # residual over the fit's own error that is reported
FALL = 0.1  # relative reduction of the error by refitting friction that is reported
CERTAIN = 4.0  # standard deviations of a change of friction that is reported


def rms(errors: Sequence[Array]) -> Array:
    """Return the RMS (n,) of each joint, NaN for a joint without rows."""
    return np.array([np.sqrt(np.mean(e**2)) if len(e) else np.nan for e in errors])


def _too_uncertain(values: Array, std: Array) -> Mask:
    """Mark quantities (10,) whose uncertainty exceeds their size; without mass, all others too."""
    unknown = ~(std <= _sizes(values))
    unknown[1:] |= _no_mass(values, std)
    return unknown


def _no_mass(values: Array, std: Array) -> bool:
    return not abs(values[0]) > INSIGNIFICANT * std[0]


def _sizes(values: Array) -> Array:
    """Return the sizes (10,) that standard deviations are compared with."""
    moment = float(np.max(np.abs(values[[4, 6, 9]])))
    places = np.maximum(np.abs(values[1:4]), LENGTH / WEAK)
    return np.array([max(abs(values[0]), MASS / WEAK), *places, *(moment,) * 6])


def _not_identified(
    values: Array, std: Array, identifiable: Mask, hidden: Array
) -> tuple[NotIdentified, ...]:
    """Return the quantities that cannot be identified from the recording, with reasons."""
    sizes, found = _sizes(values), []
    for k, name in enumerate(body.NAMES):
        if not identifiable[k]:
            reason = _hidden_reason(k, hidden)
        elif k > 0 and _no_mass(values, std):
            reason = f"the mass, {with_std(values[0], std[0])} kg, is not significant"
        elif not std[k] <= WEAK * sizes[k]:
            part = 100.0 * std[k] / max(sizes[k], 1e-300)
            reason = f"standard deviation {std[k]:.2g} {body.UNITS[k]}, {part:.0f} % of its size"
            reason += ": the motion is too slow or too small"
        else:
            continue
        found.append(NotIdentified(name, reason))
    return tuple(found)


def _hidden_reason(k: int, hidden: Array) -> str:
    for direction in hidden:
        if np.any(body.DEPENDS_ON[k] & (np.abs(direction) > 1e-6)):
            return (
                f"the torque does not depend on {name_direction(direction, LABELS)} "
                "(for this arm, or in this motion)"
            )
    return "a mass of exactly zero has no centre"


LABELS = tuple(name.replace("mc", "m·c") for name in LINK_PARAMETER_NAMES)


def _fit_warnings(fit: Fit, recordings: Sequence[Recording]) -> list[LieidWarning]:
    """Warn of recordings that the fit was trained on."""
    # parts of one file (FILE@T0:T1) have its hash and names of their own
    trained = {(source.sha256, source.name) for source in fit.provenance.recordings}
    return [
        SameRecordingWarning(
            f"{r.name or 'the recording'} is one of the fit's training recordings: its payload is "
            "already part of the fit"
        )
        for r in recordings
        if r.source_hash and (r.source_hash, r.name) in trained
    ]


def _changed_friction(
    run: LoadedRun,
    kept: LoadedRunEstimate,
    refitted: LoadedRunEstimate,
    frictional: Mask,
) -> list[LieidWarning]:
    """Warn of friction that differs from the fit's and was identified again."""
    before, after = rms(kept.after), rms(refitted.after)
    fall = np.nan_to_num(1.0 - after / np.where(before > 0.0, before, np.inf))
    free = np.flatnonzero(frictional | run.drifting)
    columns = run.fit.model.base_columns
    certain = np.abs(refitted.free) > CERTAIN * refitted.free_std
    parts = [
        f"{columns[k].label} {run.fit.values[k]:.3g} → {run.fit.values[k] + change:.3g}"
        for k, change, sure in zip(free, refitted.free, certain, strict=True)
        if sure and frictional[k] and fall[columns[k].joint] > FALL
    ]
    if not parts:
        return []
    std = float(np.sqrt(kept.covariance[0, 0]))
    return [
        FrictionChangedWarning(
            f"friction differs from that of the fit ({', '.join(parts[:6])}"
            f"{', …' if len(parts) > 6 else ''}) and was identified again; with the friction of "
            f"the fit the mass would be {with_std(float(kept.parameters[0]), std)} kg"
        )
    ]


def _payload_warnings(
    fit: Fit, result: PayloadEstimate, estimate: LoadedRunEstimate, residuals: Array
) -> Iterator[LieidWarning]:
    """Warn of a negative mass, no convergence, large residuals (n,) with the fit's friction."""
    if result.mass < 0.0:
        significant = result.mass < -INSIGNIFICANT * result.mass_std
        yield NegativeMassWarning(
            f"mass {with_std(result.mass, result.mass_std)} kg is negative"
            f"{'' if significant else ', but not significantly'}"
        )
    own = np.maximum(np.where(np.isfinite(fit.rms_cv), fit.rms_cv, fit.noise), 1e-9)
    for j, residual in enumerate(residuals):
        if np.isfinite(result.rms_after[j]) and residual > MISFIT * own[j]:
            yield PayloadMisfitWarning(
                f"joint {j + 1}: the residual with the payload and the friction of the fit is "
                f"{residual:.3g} N·m, "
                f"{residual / own[j]:.1f} times the fit's own error; the payload is less "
                "accurate than its standard deviations state (lieid diagnose FIT REC finds "
                "what else has changed)"
            )
    if not estimate.converged:
        yield ConvergenceWarning("the iteration of load and payload did not converge")


ROUNDING = 1e-10  # least variance relative to the sum of its terms before cancellation
REFITTED = ("coulomb", "viscous", "offset")  # effects that change with temperature and wear


@blas_on_one_thread
def identify_payload(
    fit: Fit,
    recordings: Recording | Sequence[Recording],
    *,
    cutoff: float | None = None,
    progress: Progress | None = None,
) -> PayloadEstimate:
    """Identify a payload at the tool that a fit does not include.

    The difference between the measured torque and the fit's prediction is regressed on the
    columns of a body at the tool, both through the fit's filter, while the parameters of the fit
    may move within their uncertainty. Load-dependent friction accounts for the payload. Coulomb
    friction, viscous friction and offsets that have changed significantly, as with the temperature,
    are identified again from this run, which a warning states.

    ``fit``: identified without the payload, by any method; ``recordings``: with the payload, with
    torques; ``cutoff``: of the low-pass filter, Hz, by default that of the fit; ``progress`` is
    called with the name of a stage and the completed fraction (0 to 1). Mass and inertia scale with
    the torque constants where torques come from motor currents; their standard deviations do not
    contain an error of these constants.
    Raises `ModelError`, `EffectError`, `RecordingError`: the recordings do not match the model.
    Raises `IdentificationError`: no joint moves, or the motion identifies no parameter of a
    payload.

    Khalil, Gautier, Lemoine, "Identification of the payload inertial parameters of industrial
    manipulators", ICRA 2007.
    """
    given = listed(recordings)
    report = progress or (lambda stage, fraction: None)
    recording_checks.check_recordings(fit.model, given)
    report("check", 0.0)
    checked = [w for recording in given for w in check(recording, fit.model.robot)]
    found = _fit_warnings(fit, given)
    found += [w for r in given for w in recording_checks.check_torque_constants(fit.provenance, r)]
    report("process", 0.2)
    options = fit.processing if cutoff is None else replace(fit.processing, cutoff=cutoff)
    segments, _ = center_temperature(process(given, options), fit.temperature_mean)
    require_one_load(segments)
    run = LoadedRun(fit, Design(fit.compiled, segments))
    if not run.design.rows(fit.shapes, fit.parameters).lengths.any():
        raise IdentificationError(
            "no joint moves in the loaded run; expected a motion like that of the fit's training"
        )
    frictional = np.array([name in REFITTED for name in run.names])
    report("regress", 0.4)
    kept = run.estimate(np.zeros_like(frictional))
    refitted = run.estimate(frictional) if frictional.any() else kept
    changed = _changed_friction(run, kept, refitted, frictional)
    estimate = refitted if changed else kept
    if len(estimate.hidden) >= len(estimate.parameters):
        raise IdentificationError(
            f"{given[0].name or 'the recordings'}: no parameter of a payload can be identified "
            "from this motion with this fit; expected a motion of several joints, in both"
        )
    found += [*checked, *changed]
    result = replace(
        _result(fit, run, estimate),
        recordings=tuple(recording_checks.Source.of(r) for r in given),
    )
    found += [w for segment in segments for w in segment.warnings]
    found += _payload_warnings(fit, result, estimate, kept.noise)
    report("done", 1.0)
    return replace(result, warnings=unique_warnings(found))


def require_one_load(segments: Sequence[Processed]) -> None:
    """Raise if the column ``load`` contains several payloads."""
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


def _result(fit: Fit, run: LoadedRun, estimate: LoadedRunEstimate) -> PayloadEstimate:
    hidden = estimate.hidden / body.SCALE
    hidden = hidden / np.maximum(np.abs(hidden).max(axis=1, keepdims=True), 1e-300)
    identifiable = body.identifiable_quantities(hidden)
    values, std = body.physical_quantities(estimate.parameters), np.full(10, np.nan)
    if estimate.parameters[0] != 0.0:
        std = _propagated(body.physical_jacobian(estimate.parameters), estimate.covariance)
    else:
        identifiable[:] = False
    not_identified = _not_identified(values, std, identifiable, hidden)
    unknown = ~identifiable | _too_uncertain(values, std)
    return PayloadEstimate(
        robot=fit.model.robot.name,
        frame=_frame(fit.model.robot),
        joint_names=tuple(joint.name for joint in fit.model.robot.joints),
        values=np.where(unknown, np.nan, values),
        std=np.where(unknown, np.nan, std),
        parameters=estimate.parameters,
        covariance=estimate.covariance,
        not_identified=not_identified,
        rms_before=rms(estimate.before),
        rms_after=rms(estimate.after),
        rms_fit=np.where(np.isfinite(fit.rms_cv), fit.rms_cv, fit.noise),
        cutoff=run.design.segments[0].cutoff,
        recordings=(),
        warnings=(),
    )


def _propagated(jacobian: Array, covariance: Array) -> Array:
    """Return standard deviations of linear functions, bounded below by rounding errors."""
    variance = np.einsum("ij,jk,ik->i", jacobian, covariance, jacobian)
    uncorrelated = jacobian**2 @ np.diag(covariance)
    return np.asarray(np.sqrt(np.maximum(variance, ROUNDING * uncorrelated)))
