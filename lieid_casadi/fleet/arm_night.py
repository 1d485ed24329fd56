"""One arm-night: read the recording, check it, diagnose it against the arm's fit."""

from __future__ import annotations

import tempfile
import time
from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import orth

from lieid_casadi.arrays import Array
from lieid_casadi.diagnosis import Diagnosis, Step, diagnose
from lieid_casadi.errors import FleetError, LieidError, MissingDependency, RecordingError
from lieid_casadi.fleet.night_result import (
    ArmNight,
    Finding,
    JointError,
    NightResult,
    ParameterEstimate,
)
from lieid_casadi.fleet.recordings import local_copy
from lieid_casadi.identification import Fit
from lieid_casadi.identification.prediction import center_temperature
from lieid_casadi.identification.recording_checks import Source, check_recordings
from lieid_casadi.identification.regression.design_matrix import Design, rows_per_independent
from lieid_casadi.identification.regression.least_squares import (
    Factor,
    joint_factors,
    row_weights,
)
from lieid_casadi.identification.uncertainty.covariance import prior_rows
from lieid_casadi.json_numbers import number_or_none
from lieid_casadi.premises import PremiseCheck, check
from lieid_casadi.recording import Recording, process, require_plausible_units
from lieid_casadi.recording.readers.registry import hash_of_file
from lieid_casadi.robot.inertia import parameter_transport

UNDETERMINED = 1e-9  # of scaled columns: directions that the night does not excite
DESCRIBED = 1.5  # error of nights over the held-out error, up to which a fit describes an arm


@dataclass(frozen=True, eq=False)
class NightRows:
    """Equations of one night, one factor per joint, weighted to unit noise.

    ``size`` (n,) is the noise of a row, N·m: that of a joint, N·m, for rows that are correlated.
    """

    fit: Fit
    factors: list[Factor]
    size: Array
    noise: Array

    @classmethod
    def of(cls, fit: Fit, recording: Recording) -> NightRows:
        """Return the equations of a recording with the fit's held-out error as noise."""
        noise = np.fmax(fit.rms_cv, fit.noise)
        segments, _ = center_temperature(process([recording], fit.processing), fit.temperature_mean)
        rows = Design(fit.compiled, segments).rows(fit.shapes, fit.parameters)
        size = noise * np.sqrt(rows_per_independent(segments[0]))
        return cls(fit, joint_factors(rows, row_weights(rows, 1.0 / size)), size, noise)

    @property
    def matrix(self) -> Array:
        """Columns of the base parameters (R, p) of all joints."""
        return np.concatenate([factor.r[:, :-1] for factor in self.factors])

    @property
    def torque(self) -> Array:
        """Torque (R,) of all joints."""
        return np.concatenate([factor.r[:, -1] for factor in self.factors])

    def errors(self, values: Array) -> Array:
        """Return the RMS error (n,) of base parameters (p,), in multiples of the noise."""
        counts = np.maximum([factor.rows for factor in self.factors], 1)
        misfit = np.array([factor.misfit(values) for factor in self.factors])
        return np.asarray(np.sqrt(misfit / counts) * self.size / self.noise)

    def torque_rms(self) -> Array:
        """Return the RMS of the measured torque in motion (n,), N·m."""
        return self.errors(np.zeros(len(self.fit.values))) * self.noise

    def coefficients(self) -> tuple[ParameterEstimate, ...]:
        """Return the effect coefficients of the night.

        Inertial parameters have the fit's estimate and covariance as prior, coefficients of effects
        are free. A change of friction is therefore not reduced by the prior, and errors of the
        inertial parameters enter the standard deviations, which follow from the noise alone.
        """
        fit, count = self.fit, len(self.fit.values)
        effects = np.flatnonzero(fit.model.base.kept >= 10 * fit.model.n)
        links = np.setdiff1d(np.arange(count), effects)
        prior = np.zeros((len(links), count))
        prior[:, links] = prior_rows(fit.covariance[np.ix_(links, links)])
        change, covariance = _with_prior(self.matrix, self.torque - self.matrix @ fit.values, prior)
        std, columns = np.sqrt(np.maximum(np.diag(covariance), 0.0)), fit.model.base_columns
        return tuple(
            ParameterEstimate(
                columns[k].name, columns[k].joint + 1, float(fit.values[k] + change[k]),
                float(std[k]), columns[k].unit,
            )
            for k in effects
        )  # fmt: skip

    def joints_of_other_arm(self) -> NDArray[np.intp]:
        """Return the joints whose torque the kinematics cannot explain with any parameters."""
        scale = np.linalg.norm(self.matrix, axis=0)
        scale[scale == 0.0] = 1.0
        free = np.linalg.lstsq(self.matrix / scale, self.torque, rcond=UNDETERMINED)[0] / scale
        over_noise = self.errors(free)
        torque = self.torque_rms()
        part = np.divide(
            over_noise * self.noise, torque, out=np.zeros_like(torque), where=torque > 0
        )
        other = (part > OTHER_ARM_PART) & (over_noise > OTHER_ARM_NOISE)
        many = 2 * other.sum() >= len(other) and other.sum() > 1
        return np.flatnonzero(other) if many else np.zeros(0, dtype=np.intp)


def _with_prior(matrix: Array, residual: Array, prior: Array) -> tuple[Array, Array]:
    """Return the change of the parameters (p,), zero where undetermined, and its covariance."""
    both = np.concatenate([matrix, prior])
    target = np.concatenate([residual, np.zeros(len(prior))])
    scale = np.linalg.norm(both, axis=0)
    scale[scale == 0.0] = 1.0
    u, sizes, vt = np.linalg.svd(both / scale, full_matrices=False)
    least = UNDETERMINED * sizes.max(initial=1e-300)
    used = sizes > least
    change = vt[used].T @ ((u[:, used].T @ target) / sizes[used]) / scale
    spread = vt.T / np.maximum(sizes, least) / scale[:, None]
    return change, spread @ spread.T


@dataclass(frozen=True, eq=False)
class Reidentified:
    """A fit after a lasting change of the arm."""

    fit: Fit
    coefficients: tuple[str, ...]  # that were estimated again; ``payload``: of the last link
    error_ratio: Array  # (n,) largest error of the nights over the held-out error of the old fit

    @property
    def holds(self) -> bool:
        """Whether the fit describes the arm again on every joint."""
        return bool((self.error_ratio <= DESCRIBED).all())


def reidentified(
    nights: Sequence[ArmNight], fit_content: bytes, changed: Collection[str]
) -> Reidentified:
    """Return a fit whose changed coefficients are estimated again from the nights since.

    ``changed`` names what is free: coefficients (``coulomb.f_c:2``), effects of the model
    (``coulomb:2``), or ``payload`` for all parameters of the last link. All other parameters are
    held within the uncertainty of the fit, so that nights with little motion are enough.
    """
    every, sources = [], []
    for night in nights:
        with local_copy(night.recording) as path:
            loaded, recording = load_night(night, fit_content, path)
        every.append(NightRows.of(loaded, recording))
        sources.append(Source.of(recording))
    fit = _fit(fit_content, None, None)
    model, count = fit.model, len(fit.values)
    free, names = np.zeros((count, 0)), list[str]()
    for k, column in enumerate(model.base_columns):
        label, joint = f"{column.name}:{column.joint + 1}", column.joint + 1
        if label in changed or f"{column.name.partition('.')[0]}:{joint}" in changed:
            free, names = np.column_stack([free, np.eye(count)[k]]), [*names, label]
    if "payload" in changed:
        last = model.base.combination[:, 10 * (model.n - 1) : 10 * model.n]
        free, names = np.column_stack([free, last]), [*names, "payload"]
    held = prior_rows(fit.covariance[:count, :count])
    released = orth(held @ free)
    held -= released @ (released.T @ held)
    matrix = np.concatenate([rows.matrix for rows in every])
    rest = np.concatenate([rows.torque - rows.matrix @ rows.fit.values for rows in every])
    change, own = _with_prior(matrix, rest, held)
    covariance = np.zeros_like(fit.covariance)
    covariance[:count, :count] = own
    covariance[count:, count:] = fit.covariance[count:, count:]
    provenance = replace(fit.provenance, recordings=(*fit.provenance.recordings, *sources))
    values = fit.values + change
    again = replace(
        fit, values=values, parameters=model.base.lift(values, fit.parameters), method="wls",
        covariance=covariance, certificate=None, provenance=provenance,
    )  # fmt: skip
    ratios = [rows.errors(rows.fit.values + change) for rows in every]
    return Reidentified(again, tuple(names), np.max(ratios, axis=0))


FITS_KEPT = 16  # per worker, with their compiled models
# A recording is of another arm if, for at least half of the joints, this part of the torque and
# this multiple of the noise is not explained by the robot's regressor with any parameters.
# Simulated changes of an arm (tilted base, encoder offset of 0.1 rad) stay below on most joints.
OTHER_ARM_PART, OTHER_ARM_NOISE = 0.2, 5.0
#: Error of the fit, in multiples of its held-out error, from which on the premises are tested: a
#: wrong premise at least triples an error, and the test takes longer than a diagnosis.
SUSPICIOUS = 2.0
#: Premises that are no reason of their own if no inertias explain the torque of half of the joints.
OF_TORQUE = ("robot_mismatch", "torque_sign", "torque_unit")


def run_arm_night(night: ArmNight, fit_content: bytes) -> NightResult:
    """Return the result of an arm-night; errors of the recording are part of it."""
    start, sha = time.perf_counter(), ""
    try:
        with local_copy(night.recording) as path:
            sha = hash_of_file(path)
            if night.run_id(sha) in night.done:
                return NightResult("done", recording_sha256=sha, repeated=True)
            result = _diagnosed(night, fit_content, path)
    except (FleetError, MissingDependency) as error:
        result = NightResult("failed", str(error))
    except LieidError as error:
        result = NightResult("refused", str(error).replace(f"{path}", night.recording))
    seconds = time.perf_counter() - start
    return replace(result, recording_sha256=sha, seconds=seconds)


def _diagnosed(night: ArmNight, fit_content: bytes, path: Path) -> NightResult:
    fit, recording = load_night(night, fit_content, path)
    rows = NightRows.of(fit, recording)
    other = rows.joints_of_other_arm()
    if len(other) or (rows.errors(fit.values) > SUSPICIOUS).any():
        _require_premises(fit, recording, other)
    diagnosis = diagnose(fit, recording)
    return NightResult(
        "done",
        payload=(recording.payload_label or ("",))[0],
        findings=tuple(_finding(step) for step in diagnosis.steps) + _unexplained(diagnosis),
        parameters=rows.coefficients(),
        errors=_errors(diagnosis, rows, recording),
        checks=tuple((type(w).__name__, str(w)) for w in diagnosis.warnings),
    )


def load_night(night: ArmNight, fit_content: bytes, path: Path) -> tuple[Fit, Recording]:
    """Return the fit of an arm, with the known payload, and a recording that fits its model."""
    fit = _fit(fit_content, None, None)
    robot = fit.model.robot
    recording = Recording.load(
        path,
        torque_constants=night.torque_constants,
        n=robot.n,
        joint_names=[joint.name for joint in robot.joints],
        revolute=np.array([joint.revolute for joint in robot.joints]),
    )
    payload = _payload(night, recording)
    if payload is not None:
        fit = _fit(fit_content, payload, night.tool)
    check_recordings(fit.model, [recording])
    require_plausible_units(recording, robot)
    return fit, recording


def premises_of(fit: Fit, recording: Recording) -> PremiseCheck | None:
    """Return the test of the premises; None of a recording that is too short, or of commands."""
    if recording.command is not None:
        return None  # torques of drive laws are assumptions themselves
    try:
        return check(fit, recording)
    except LieidError:
        return None


def _require_premises(fit: Fit, recording: Recording, other: NDArray[np.intp]) -> None:
    """Refuse a recording that does not belong to the robot as it is described.

    ``other``: joints (from 0) whose torque no inertias explain, which a premise about the torque
    alone cannot be the reason of.
    """
    found = premises_of(fit, recording)
    certain = [x for x in found.findings if x.certain] if found is not None else []
    if certain and not (len(other) and certain[0].premise in OF_TORQUE):
        names = ", ".join(finding.premise for finding in certain)
        raise RecordingError(
            f"{recording.title}: robot and recording do not belong together ({names}): "
            f"{certain[0].sentence}"
        )
    if len(other):
        joints = ", ".join(str(j + 1) for j in other)
        raise RecordingError(
            f"{recording.title}: the kinematics do not fit: with any inertias and friction, robot "
            f"{fit.model.robot.name!r} leaves more than {100 * OTHER_ARM_PART:.0f} % of the torque "
            f"of joints {joints} unexplained; check that the recording is of this arm"
        )


@lru_cache(maxsize=FITS_KEPT)
def _fit(content: bytes, payload: tuple[float, ...] | None, tool: tuple[float, ...] | None) -> Fit:
    """Return the fit of a file's content, with a known payload added to the last link."""
    if payload is None:
        with tempfile.NamedTemporaryFile(suffix=".json", prefix="lieid-fleet-") as file:
            file.write(content)
            file.flush()
            return Fit.load(file.name)
    fit = _fit(content, None, None)
    robot, base = fit.model.robot, fit.model.base
    pose = robot.tool if tool is None else np.reshape(tool, (4, 4))
    change = np.zeros(len(fit.parameters))
    change[10 * (robot.n - 1) : 10 * robot.n] = parameter_transport(pose) @ np.array(payload)
    return replace(
        fit, parameters=fit.parameters + change, values=fit.values + base.combination @ change
    )


def _payload(night: ArmNight, recording: Recording) -> tuple[float, ...] | None:
    """Return the parameters (10,) of the recording's known payload."""
    if not night.payloads:
        return None
    labels = sorted(set(recording.payload_label or ("",)))
    if len(labels) > 1:
        raise RecordingError(
            f"{recording.title}: payloads {', '.join(map(repr, labels))} in one recording; "
            "expected one recording per payload"
        )
    known = dict(night.payloads)
    if labels[0] not in known and labels[0]:
        raise RecordingError(
            f"{recording.title}: payload {labels[0]!r} is not in the fleet file; expected one of "
            f"{', '.join(map(repr, known))}"
        )
    return known.get(labels[0])


def _finding(step: Step) -> Finding:
    """Return a step as a row; its change is that of the parameters in the first one's unit."""
    first, unit = next(iter(step.units.items()), ("", ""))
    same = [name for name in step.parameters if step.units[name] == unit]
    values = np.array([step.parameters[name] for name in same])
    deviations = np.array([step.std[name] for name in same])
    change = float(values[0]) if len(same) == 1 else float(np.linalg.norm(values))
    spread = deviations @ np.abs(values) / max(float(np.linalg.norm(values)), 1e-300)
    rivals = ", ".join(rival.label for rival in step.rivals)
    sentence = f"{step.label}: {first} = {step.parameters[first]:.4g} {unit}" if first else ""
    return Finding(
        step.effect,
        step.joints[0] + 1 if step.joints else None,
        change,
        number_or_none(float(spread)),
        unit,
        float(np.nan_to_num(step.share)),
        sentence + (f"; fits as well: {rivals}" if rivals else ""),
        rivals,
    )


def _unexplained(diagnosis: Diagnosis) -> tuple[Finding, ...]:
    """Return the unexplained parts of the residual as rows; their change is in N·m RMS."""
    moving = diagnosis.baseline["rms_test_moving"]
    assert moving is not None
    sizes = [float(moving[x.joint]) * float(np.sqrt(x.fraction)) for x in diagnosis.unexplained]
    return tuple(
        Finding("unexplained", part.joint + 1, size, None, "N·m", 0.0, part.relation)
        for part, size in zip(diagnosis.unexplained, sizes, strict=True)
    )


def _errors(diagnosis: Diagnosis, rows: NightRows, recording: Recording) -> tuple[JointError, ...]:
    moving, expected = diagnosis.baseline["rms_test_moving"], diagnosis.expected
    assert moving is not None
    assert expected is not None
    q, none = recording.q, np.full(recording.q.shape, np.nan)
    warm = none if recording.temperature is None else recording.temperature
    columns = (
        moving, diagnosis.noise_floor, expected, rows.torque_rms(), warm.mean(axis=0),
        q.min(axis=0), q.max(axis=0), q.mean(axis=0), q.std(axis=0),
    )  # fmt: skip
    return tuple(
        JointError(j, *map(number_or_none, row))
        for j, row in enumerate(zip(*columns, strict=True), start=1)
    )
