"""One arm-night: read the recording, check it, diagnose it against the arm's fit."""

from __future__ import annotations

import tempfile
import time
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

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
from lieid_casadi.identification.recording_checks import check_recordings
from lieid_casadi.identification.regression.design_matrix import Design, rows_per_independent
from lieid_casadi.identification.regression.least_squares import Factor, joint_factors, row_weights
from lieid_casadi.identification.uncertainty.covariance import prior_rows
from lieid_casadi.json_numbers import number_or_none
from lieid_casadi.premises import check_where_possible
from lieid_casadi.premises.correction import correction_of, load_by_columns
from lieid_casadi.recording import Recording, process, require_plausible_units
from lieid_casadi.recording.readers.registry import hash_of_file
from lieid_casadi.robot.inertia import parameter_transport

UNDETERMINED = 1e-9  # of scaled columns: directions that the night does not excite


@dataclass(frozen=True, eq=False)
class NightRows:
    """Equations of one night, one factor per joint, weighted to unit noise."""

    fit: Fit
    factors: list[Factor]
    size: Array  # (n,) noise of a row, N·m
    noise: Array  # (n,) of a joint, N·m: rows are correlated

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
        both = np.concatenate([self.matrix, prior])
        target = np.append(self.torque - self.matrix @ fit.values, np.zeros(len(prior)))
        scale = np.linalg.norm(both, axis=0)
        scale[scale == 0.0] = 1.0
        u, sizes, vt = np.linalg.svd(both / scale, full_matrices=False)
        used = sizes > UNDETERMINED * sizes.max(initial=1e-300)
        change = vt[used].T @ ((u[:, used].T @ target) / sizes[used]) / scale
        least = np.maximum(sizes, UNDETERMINED * sizes.max(initial=1e-300))
        std = np.linalg.norm(vt.T / least, axis=1) / scale
        columns = fit.model.base_columns
        return tuple(
            ParameterEstimate(
                columns[k].name, columns[k].joint + 1, float(fit.values[k] + change[k]),
                float(std[k]), columns[k].unit,
            )
            for k in effects
        )  # fmt: skip


FITS_KEPT = 16  # per worker, with their compiled models
#: Error of the fit, in multiples of its held-out error, from which on the premises are tested: a
#: wrong premise at least triples an error, and the test takes longer than a diagnosis.
SUSPICIOUS = 2.0


def run_arm_night(night: ArmNight, fit_content: bytes) -> NightResult:
    """Return the result of an arm-night; errors of the recording are part of it."""
    started, start, sha = datetime.now(UTC), time.perf_counter(), ""
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
    return replace(result, recording_sha256=sha, seconds=seconds, started=started)


def _diagnosed(night: ArmNight, fit_content: bytes, path: Path) -> NightResult:
    fit, recording = load_night(night, fit_content, path)
    rows = NightRows.of(fit, recording)
    if (rows.errors(fit.values) > SUSPICIOUS).any():
        refusal = check_where_possible(fit, [recording]).refusal
        if refusal:
            raise RecordingError(f"{recording.title}: {refusal}")
    diagnosis = diagnose(fit, recording)
    return NightResult(
        "done",
        payload=(recording.payload_label or ("",))[0],
        findings=tuple(_finding(step) for step in diagnosis.steps) + _unexplained(diagnosis),
        parameters=rows.coefficients(),
        errors=_errors(diagnosis, rows, recording),
    )


def load_night(night: ArmNight, fit_content: bytes, path: Path) -> tuple[Fit, Recording]:
    """Return the fit of an arm, with the known payload, and a recording that fits its model."""
    fit = _fit(fit_content, None, None)
    robot, read = fit.model.robot, fit.provenance
    options: dict[str, Any] = {
        "torque_constants": night.torque_constants,
        "n": robot.n,
        "joint_names": [joint.name for joint in robot.joints],
        "revolute": np.array([joint.revolute for joint in robot.joints]),
        "units": read.units,
    }
    recording = load_by_columns(path, read.columns, options)
    recording = correction_of(read.corrections, robot.n).of_recording(recording)
    payload = _payload(night, recording)
    if payload is not None:
        fit = _fit(fit_content, payload, night.tool)
    check_recordings(fit.model, [recording])
    require_plausible_units(recording, robot)
    return fit, recording


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
        sentence + (f"; rivals: {rivals}" if rivals else ""),
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
