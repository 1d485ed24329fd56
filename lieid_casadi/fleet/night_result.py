"""An arm-night as a task, and its result as rows of the history."""

from __future__ import annotations

import hashlib
import json
from dataclasses import dataclass
from typing import Literal

Status = Literal["done", "refused", "failed"]


@dataclass(frozen=True)
class ArmNight:
    """One recording of one arm, to be diagnosed.

    Attributes
    ----------
    serial : str
    date : str
        ISO 8601, UTC.
    recording : str
        Path or URL.
    stamp : str
        Of the file; see `RecordingFile`.
    fit_sha256 : str
        Of the content of the fit's file.
    torque_constants : tuple of float or None
        N·m/A.
    tool : tuple of float or None
        Pose (16,) of the payload's frame in the last link's frame, row by row; None: the robot's
        own tool frame.
    payloads : tuple of (str, tuple of float)
        Label and parameters (10,) of the known payloads.
    done : frozenset of str
        ``run_id`` of recordings of this arm that are in the history.
    """

    serial: str
    date: str
    recording: str
    stamp: str
    fit_sha256: str
    torque_constants: tuple[float, ...] | None = None
    tool: tuple[float, ...] | None = None
    payloads: tuple[tuple[str, tuple[float, ...]], ...] = ()
    done: frozenset[str] = frozenset()

    @property
    def condition(self) -> str:
        """Hash of what is known of the arm beside its fit: constants, tool, payloads."""
        return _hash(self.torque_constants, self.tool, self.payloads)

    def run_id(self, recording_sha256: str, version: str) -> str:
        """Return the identity of a run: arm, recording, fit, condition and version."""
        return _hash(self.serial, recording_sha256, self.fit_sha256, self.condition, version)


@dataclass(frozen=True)
class Finding:
    """An effect that a diagnosis found; joint from 1, None for the whole arm."""

    effect: str
    joint: int | None
    change: float
    std: float | None
    unit: str
    severity: float
    sentence: str


@dataclass(frozen=True)
class ParameterEstimate:
    """An effect coefficient of a night; joint from 1."""

    name: str
    joint: int
    value: float
    std: float
    unit: str


@dataclass(frozen=True)
class JointError:
    """Error of the fit on a night, N·m, and the positions of its motion; joint from 1."""

    joint: int
    rms_moving: float | None
    noise_floor: float | None
    expected: float | None
    torque_rms: float | None
    temperature: float | None
    q_low: float | None = None
    q_high: float | None = None
    q_mean: float | None = None
    q_std: float | None = None


@dataclass(frozen=True)
class NightResult:
    """Result of one arm-night, as rows.

    Attributes
    ----------
    status : str
        ``done``; ``refused``: the recording cannot be used; ``failed``: it may be tried again.
    reason : str
        Of a status other than ``done``.
    recording_sha256 : str
        Empty if the recording could not be read.
    seconds : float
    repeated : bool
        Whether the history has this run already; the rows are then empty.
    payload : str
        Label of the recording's payload.
    """

    status: Status
    reason: str = ""
    recording_sha256: str = ""
    seconds: float = 0.0
    repeated: bool = False
    payload: str = ""
    findings: tuple[Finding, ...] = ()
    parameters: tuple[ParameterEstimate, ...] = ()
    errors: tuple[JointError, ...] = ()
    checks: tuple[tuple[str, str], ...] = ()


def _hash(*parts: object) -> str:
    return hashlib.sha256(json.dumps(parts).encode()).hexdigest()[:32]
