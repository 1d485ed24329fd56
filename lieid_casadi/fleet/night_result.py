"""An arm-night as a task, and its result as rows of the history."""

from __future__ import annotations

import hashlib
import json
import secrets
from collections.abc import Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime
from typing import TYPE_CHECKING, Any, Literal

from lieid_casadi import __version__

if TYPE_CHECKING:
    from pyarrow import Table

Status = Literal["done", "refused", "failed"]
#: Number of the method by which a night is diagnosed: raised when it gives other results.
METHOD = 3


@dataclass(frozen=True)
class ArmNight:
    """One recording of one arm, to be diagnosed."""

    serial: str
    date: str  # ISO 8601, UTC
    recording: str  # path or URL
    stamp: str  # of the file; see `RecordingFile`
    fit_sha256: str  # of the content of the fit's file
    torque_constants: tuple[float, ...] | None = None  # N·m/A
    tool: tuple[float, ...] | None = None  # pose (16,) of the tool in the last link's frame
    payloads: tuple[tuple[str, tuple[float, ...]], ...] = ()  # label and parameters (10,)
    done: frozenset[str] = frozenset()  # ``run_id`` of recordings that are in the history
    method: int = METHOD

    @property
    def key(self) -> tuple[str, str, str, str, str]:
        """What identifies the file, and what it is diagnosed with."""
        return self.serial, self.recording, self.stamp, self.fit_sha256, self.condition

    @property
    def condition(self) -> str:
        """Hash of what is known of the arm beside its fit: constants, tool, payloads."""
        return _hash(self.torque_constants, self.tool, self.payloads)

    def run_id(self, recording_sha256: str) -> str:
        """Return the identity of a run: arm, recording, fit, condition and method."""
        return _hash(
            self.serial, recording_sha256, self.fit_sha256, self.condition, f"method {self.method}"
        )


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
    rivals: str = ""  # effects that fit as well, separated by commas


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
    """Result of one arm-night, as rows."""

    status: Status  # ``refused``: it cannot be used; ``failed``: it may be tried again
    reason: str = ""  # of a status other than ``done``
    recording_sha256: str = ""  # empty if the recording could not be read
    seconds: float = 0.0
    repeated: bool = False  # the history has this run already; the rows are then empty
    payload: str = ""  # label of the recording's payload
    findings: tuple[Finding, ...] = ()
    parameters: tuple[ParameterEstimate, ...] = ()
    errors: tuple[JointError, ...] = ()
    version: str = __version__  # of the worker
    started: datetime = field(default_factory=lambda: datetime.now(UTC))


#: Tables with rows of a run.
ROWS = ("findings", "parameters", "errors")


@dataclass(frozen=True, eq=False)
class Batch:
    """Results of some arm-nights: their rows as Arrow tables, and a line of each."""

    tables: dict[str, Table]  # by the table of the history; none without rows
    lines: tuple[tuple[str, str, str, str], ...]  # serial number, date, status and reason

    @classmethod
    def of(cls, results: Sequence[tuple[ArmNight, NightResult]]) -> Batch:
        """Return the results of arm-nights; a copy of a recording repeats its run."""
        from pyarrow import Table

        rows: dict[str, list[dict[str, Any]]] = {name: [] for name in (*ROWS, "repeats", "runs")}
        lines, known = [], set[str]()
        for night, result in results:
            run_id = night.run_id(result.recording_sha256)
            repeated = result.repeated or run_id in known
            lines.append((
                night.serial, night.date, "repeated" if repeated else result.status, result.reason
            ))  # fmt: skip
            file = {"serial": night.serial, "recording": night.recording, "stamp": night.stamp}
            if repeated:
                rows["repeats"].append({"run_id": run_id, **file})
                continue
            if result.status == "failed":
                run_id = secrets.token_hex(16)  # it is tried again
            known.add(run_id)
            same = {name: getattr(result, name) for name in RESULT_COLUMNS}
            of_night = {name: getattr(night, name) for name in NIGHT_COLUMNS}
            rows["runs"].append({"run_id": run_id, **file, **of_night, **same})
            for name in ROWS:
                key = {"run_id": run_id, "serial": night.serial, "date": night.date}
                rows[name] += [key | vars(row) for row in getattr(result, name)]
        tables = {name: Table.from_pylist(own) for name, own in rows.items() if own}
        return cls(tables, tuple(lines))


NIGHT_COLUMNS = ("fit_sha256", "date", "condition", "method")
RESULT_COLUMNS = (
    "recording_sha256", "version", "started", "seconds", "status", "reason", "payload",
)  # fmt: skip


def _hash(*parts: object) -> str:
    return hashlib.sha256(json.dumps(parts).encode()).hexdigest()[:32]
