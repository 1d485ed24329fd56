"""Identify a payload from a fit without it and a run with it, and warn of contradictions.

The loaded run is regressed on the payload and on the uncertain parameters of the fit. For each
joint, with M the filtered base columns along the loaded run (load friction at the load with the
payload) and β̂ the fit's values,

    torque − M·β̂ = M·B·π + J·δ + F·φ + noise,   δ ~ N(0, C),

where π are the ten parameters of the payload, B maps them to base parameters (a body at the tool
adds to the last link), J are the derivatives with respect to values and shapes, C is the fit's
covariance, and φ are changes of free parameters (refitted friction, drift). With δ = L·z and
C = L·Lᵀ, the fit's uncertainty is an additional set of rows z = 0 with unit weight. The estimate
is therefore that of a joint identification from both runs, as in Khalil, Gautier, Lemoine,
"Identification of the payload inertial parameters of industrial manipulators", ICRA 2007, but it
does not need the data of the first run.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from lieid_casadi.arrays import Array, Indices, Mask
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
from lieid_casadi.identification.recording_checks import Source
from lieid_casadi.identification.regression.design_matrix import Design
from lieid_casadi.identification.regression.fixed_point import Progress
from lieid_casadi.identification.regression.least_squares import (
    Factor,
    JointRows,
    Rows,
    combine,
    name_direction,
    row_weights,
    solve,
)
from lieid_casadi.identification.regression.variable_projection import shape_columns
from lieid_casadi.identification.uncertainty.covariance import hac_covariance, square_root
from lieid_casadi.payload.estimate import (
    DEPENDS_ON,
    INSIGNIFICANT,
    NAMES,
    SCALE,
    UNITS,
    NotIdentified,
    PayloadEstimate,
    identifiable_quantities,
    physical_jacobian,
    physical_quantities,
)
from lieid_casadi.recording import Processed, Recording, check, process
from lieid_casadi.recording.recording import listed
from lieid_casadi.robot.inertia import LINK_PARAMETER_NAMES, parameter_transport
from lieid_casadi.robot.robot import Robot
from lieid_casadi.tables import with_std

BODY = 10
MOST_ITERATIONS = 30
CONVERGED = 1e-8  # change of the payload's torque relative to the residual
STEP = 1e-3  # kg, kg·m, kg·m²: finite difference for the derivative of load friction


@dataclass(frozen=True, eq=False)
class LoadedRunEstimate:
    """Least-squares estimate from a loaded run."""

    parameters: Array  # (10,) Payload in the tool frame (kg, kg·m, kg·m²)
    covariance: Array  # (10, 10)
    #: (h, 10) Directions of the payload's parameters that cannot be identified from the run
    hidden: Array
    free: Array  # (f,) Changes of the fit's free parameters
    free_std: Array  # (f,) their standard deviations
    before: tuple[Array, ...]  # measured − predicted torque of the fit alone per joint, N·m
    #: the same with the payload and the refitted parameters, others of the fit unchanged
    after: tuple[Array, ...]
    #: (n,) Standard deviation of the residual per joint, N·m, after the fit's parameters have been
    #: adjusted within their uncertainty
    noise: Array
    converged: bool


class LoadedRun:
    """Equations of a loaded run for a fit that was made without the payload."""

    def __init__(self, fit: Fit, design: Design) -> None:
        self.fit, self.design = fit, design
        base, n = fit.model.base, fit.model.n
        self.transport = parameter_transport(fit.model.robot.tool)
        self.to_base = base.combination[:, BODY * (n - 1) : BODY * n] @ self.transport
        self.names = [p.name.split(".")[0] for p in fit.model.base_columns]
        self.values = np.where(fit.drifting, 0.0, fit.values)
        self.root = square_root(fit.covariance)
        first = design.segments[0]
        step = float(np.median(np.diff(first.filtered_time)))
        # rows closer than half a period of the cut-off are not independent
        self.information = min(1.0, 2.0 * first.cutoff * step)

    def loaded_parameters(self, body: Array) -> Array:
        """Return link parameters and coefficients (10 n + m,) with a body at the tool."""
        parameters = self.fit.parameters.copy()
        last = BODY * self.fit.model.n
        parameters[last - BODY : last] += self.transport @ body
        return parameters

    def estimate(self, free: Mask) -> LoadedRunEstimate:
        """Estimate the payload; ``free`` marks base columns (p,) whose values are unconstrained."""
        free = free | self.fit.drifting
        noise, body = self.fit.noise, np.zeros(BODY)
        converged, before = False, self._residuals(self._rows(body), body)
        for _ in range(MOST_ITERATIONS):
            rows, errors = self._equations(body, free)
            factor = self._with_prior(combine(rows.factors, self._weights(noise)))
            solution = solve(factor)
            fresh = solution.values[:BODY]
            noise = self._noise(rows, solution.values, noise)
            moved = [j.matrix[:, :BODY] @ (fresh - body) for j in rows.joints]
            size = np.sqrt(sum(float(e @ e) for e in errors))
            change = np.sqrt(sum(float(x @ x) for x in moved))
            body = fresh
            if change <= CONVERGED * size:
                converged = True
                break
        unit = solution.unit_covariance
        each = row_weights(rows, self._weights(noise))
        covariance = hac_covariance(rows, each, rows.residuals(solution.values), unit)
        known = slice(BODY, BODY + self.root.shape[1])
        covariance = covariance + unit[:, known] @ unit[known, :]
        chosen = solution.values[BODY + self.root.shape[1] :]
        after = self._residuals(self._rows(body), body, np.flatnonzero(free), chosen)
        return LoadedRunEstimate(
            body,
            covariance[:BODY, :BODY],
            np.array([h[:BODY] for h in solution.unexcited]).reshape(-1, BODY),
            chosen,
            np.sqrt(np.diag(covariance)[BODY + self.root.shape[1] :]),
            tuple(before),
            tuple(after),
            noise,
            converged,
        )

    def _rows(self, body: Array) -> Rows:
        return self.design.rows(self.fit.shapes, self.loaded_parameters(body))

    def _residuals(
        self, rows: Rows, body: Array, free: Indices | None = None, change: Array | None = None
    ) -> list[Array]:
        values = self.values + self.to_base @ body
        if free is not None and change is not None:
            values[free] += change
        return rows.residuals(values)

    def _equations(self, body: Array, free: Mask) -> tuple[Rows, list[Array]]:
        """Return rows in [π; z; φ], linearized at a payload, and the residuals there."""
        rows, values = self._rows(body), self.values + self.to_base @ body
        errors = rows.residuals(values)
        parameters = self.loaded_parameters(body)
        by_load = self._load_slopes(rows, body, values)
        by_shape: list[Array] = [np.zeros((len(j.torque), 0)) for j in rows.joints]
        if len(self.fit.shapes):
            by_shape = shape_columns(self.design, values, self.fit.shapes, parameters)
        joints, count = [], BODY + self.root.shape[1] + int(free.sum())
        p = len(self.values)
        for joint, error, slope, shape in zip(rows.joints, errors, by_load, by_shape, strict=True):
            wide = np.zeros((len(error), p))
            wide[:, joint.columns] = joint.matrix
            payload = wide @ self.to_base + slope
            matrix = np.column_stack(
                [payload, wide @ self.root[:p] + shape @ self.root[p:], wide[:, free]]
            )
            target = error + payload @ body
            joints.append(JointRows(np.arange(count), matrix, target, joint.instant))
        return Rows(joints, count, rows.segments), errors

    def _load_slopes(self, rows: Rows, body: Array, values: Array) -> list[Array]:
        """Return the derivative of load friction with respect to the payload per joint (R, 10)."""
        varying, shapes = self.design.varying, self.fit.shapes
        slopes = [np.zeros((int(length), BODY)) for length in rows.lengths]
        if not len(varying):
            return slopes
        here = self.design.varying_rows(shapes, self.loaded_parameters(body))
        for k, unit in enumerate(STEP * np.eye(BODY)):
            there = self.design.varying_rows(shapes, self.loaded_parameters(body + unit))
            for slope, one, other in zip(slopes, here, there, strict=True):
                slope[:, k] = (other - one) @ values[varying] / STEP
        return slopes

    def _weights(self, noise: Array) -> Array:
        return np.asarray(np.sqrt(self.information) / noise)

    def _with_prior(self, factor: Factor) -> Factor:
        """Add the rows z = 0 of the fit's uncertainty."""
        known = self.root.shape[1]
        prior = np.zeros((known, factor.r.shape[1]))
        prior[:, BODY : BODY + known] = np.eye(known)
        return combine([factor, Factor(prior, known)], [1.0, 1.0])

    def _noise(self, rows: Rows, solved: Array, before: Array) -> Array:
        """Return each joint's residual standard deviation (n,)."""
        noise = before.copy()
        taken = 1.0 + BODY / max(rows.lengths.sum(), 1)
        for j, error in enumerate(rows.residuals(solved)):
            if len(error):
                noise[j] = max(float(np.sqrt(np.mean(error**2))) * taken, 1e-12)
        return noise


WEAK = 0.3  # relative standard deviation above which a quantity is reported as not identified
MASS = 0.05  # kg: a mass with this standard deviation is reported however small it is
LENGTH = 0.02  # m: the same for the centre of mass
MISFIT = 2.0  # residual over the fit's own error that is reported
FALL = 0.1  # relative reduction of the error by refitting friction that is reported
CERTAIN = 4.0  # standard deviations of a change of friction that is reported


def rms(errors: Sequence[Array]) -> Array:
    """Return the RMS (n,) of each joint, NaN for a joint without rows."""
    return np.array([np.sqrt(np.mean(e**2)) if len(e) else np.nan for e in errors])


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
    for k, name in enumerate(NAMES):
        if not identifiable[k]:
            reason = _hidden_reason(k, hidden)
        elif k > 0 and _no_mass(values, std):
            reason = f"the mass, {with_std(values[0], std[0])} kg, is not significant"
        elif not std[k] <= WEAK * sizes[k]:
            part = 100.0 * std[k] / max(sizes[k], 1e-300)
            reason = f"standard deviation {std[k]:.2g} {UNITS[k]}, {part:.0f} % of its size"
            reason += ": the motion is too slow or too small"
        else:
            continue
        found.append(NotIdentified(name, reason))
    return tuple(found)


def _hidden_reason(k: int, hidden: Array) -> str:
    for direction in hidden:
        if np.any(DEPENDS_ON[k] & (np.abs(direction) > 1e-6)):
            return (
                f"the torque does not depend on {name_direction(direction, LABELS)} "
                "(for this arm, or in this motion)"
            )
    return "a mass of exactly zero has no centre"


LABELS = tuple(name.replace("mc", "m·c") for name in LINK_PARAMETER_NAMES)


def _fit_warnings(fit: Fit, recordings: Sequence[Recording]) -> list[LieidWarning]:
    """Warn of recordings that the fit was trained on."""
    return [
        SameRecordingWarning(
            f"{r.name or 'the recording'} is one of the fit's training recordings: its payload is "
            "already part of the fit"
        )
        for r in recordings
        if fit.provenance.contains(Source.of(r))
    ]


def _changed_friction(
    run: LoadedRun, kept: LoadedRunEstimate, refitted: LoadedRunEstimate, frictional: Mask
) -> list[LieidWarning]:
    """Warn of friction that differs from the fit's and was identified again."""
    before, after = rms(kept.after), rms(refitted.after)
    fall = np.nan_to_num(1.0 - after / np.where(before > 0.0, before, np.inf))
    free = np.flatnonzero(frictional | run.fit.drifting)
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
        _result(fit, run, estimate), recordings=tuple(recording_checks.Source.of(r) for r in given)
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
    hidden = estimate.hidden / SCALE
    hidden = hidden / np.maximum(np.abs(hidden).max(axis=1, keepdims=True), 1e-300)
    identifiable = identifiable_quantities(hidden)
    values, std = physical_quantities(estimate.parameters), np.full(10, np.nan)
    if estimate.parameters[0] != 0.0:
        std = _propagated(physical_jacobian(estimate.parameters), estimate.covariance)
    else:
        identifiable[:] = False
    not_identified = _not_identified(values, std, identifiable, hidden)
    unknown = ~identifiable | ~(std <= _sizes(values))
    unknown[1:] |= _no_mass(values, std)
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
