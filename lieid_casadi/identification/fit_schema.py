"""Schema of fit files, and the migration of older ones.

Every entry of a fit file has its type here, so that a file is either valid or refused with the
path of the entry that is not.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any

import msgspec
from msgspec import Meta, Struct

from lieid_casadi.errors import FitFileError
from lieid_casadi.recording.readers.registry import reason_of

SCHEMA = 3
KIND = "lieid-fit"
LARGEST_FILE = 64 << 20  # bytes; a fit of ten joints with all effects has less than 1 MB

LARGEST = 1e100  # of any number: its square is finite
Number = Annotated[float, Meta(ge=-LARGEST, le=LARGEST)]
Positive = Annotated[float, Meta(ge=1.0 / LARGEST, le=LARGEST)]
NotNegative = Annotated[float, Meta(ge=0.0, le=LARGEST)]


class DriveFile(Struct, forbid_unknown_fields=True):
    """Control law of one joint; limits are left out where there are none."""

    stiffness: Positive
    damping: NotNegative
    proportional_limit: Positive | None
    torque_limit: Positive | None
    relative: bool
    servo: str


class RobotText(Struct, forbid_unknown_fields=True, omit_defaults=True):
    """The robot's own file, and the control laws of its drives, if it has any."""

    kind: str
    text: str
    tip: str | None
    lock: list[str]
    drives: list[DriveFile] = []


class NoiseFile(Struct, forbid_unknown_fields=True):
    """Noise of one joint's residual; ``rises`` is `Noise.motion_ratio`."""

    filter: Annotated[list[Number], Meta(min_length=1, max_length=100)]
    sigma: Positive
    spread: Positive
    rises: Annotated[float, Meta(ge=1.0, le=LARGEST)] = 1.0


class ProcessingFile(Struct, forbid_unknown_fields=True):
    """Filter options."""

    cutoff: Positive
    trim: NotNegative
    order: int
    average_periods: bool
    smoother: str


class ConditioningFile(Struct, forbid_unknown_fields=True):
    """Singular values of the full regressor."""

    largest: NotNegative
    smallest: NotNegative
    beyond: NotNegative


class WarningFile(Struct, forbid_unknown_fields=True):
    """A warning: its class and its text."""

    name: str
    message: str


class SourceFile(Struct, forbid_unknown_fields=True):
    """A training recording."""

    name: str
    sha256: str


class ProvenanceFile(Struct, forbid_unknown_fields=True):
    """Package version and training recordings, and how their torque and units were read."""

    version: str
    recordings: list[SourceFile]
    torque_constants: list[Number] | None
    units: list[Annotated[str, Meta(max_length=10)]]


class CertificateFile(Struct, forbid_unknown_fields=True):
    """Checks of physically consistent parameters."""

    regularization: NotNegative
    regularization_source: str
    pseudo_inertia_eigenvalue: list[Number]
    mass_matrix_eigenvalue: Number
    poses: int
    least_dissipation: Number | None
    divergence: list[Number]
    rms: list[NotNegative]
    rms_wls: list[NotNegative]


class Content(Struct, forbid_unknown_fields=True):
    """Everything in a fit file."""

    kind: str
    schema: int
    robot: RobotText
    effects: list[Annotated[str, Meta(max_length=200)]]
    method: str
    names: list[str]
    values: list[Number]
    shapes: list[Number]
    std: list[Number | None]
    covariance: list[list[Number | None]]
    parameters: list[Number]
    noise: list[Positive]
    residual_noise: list[NoiseFile]
    rms_train: list[NotNegative]
    rms_train_raw: list[NotNegative]
    rms_cv: list[NotNegative | None]
    processing: ProcessingFile
    conditioning: ConditioningFile
    warnings: list[WarningFile]
    provenance: ProvenanceFile
    temperature_mean: list[Number] | None
    certificate: CertificateFile | None = None


def read_content(path: Path) -> Content:
    """Return the content of a fit file, migrated to the present schema.

    Raises
    ------
    FitFileError
        Not readable, not JSON, not a fit, of a newer schema, or with an entry of another type.
    """
    data = _bytes(path)
    try:
        raw = msgspec.json.decode(data)
    except RecursionError:
        raise FitFileError(f"{path}: not a fit: nested too deeply") from None
    except (msgspec.MsgspecError, UnicodeDecodeError) as error:
        raise FitFileError(f"{path}: {_not_json(data, error)}") from None
    if not isinstance(raw, dict) or raw.get("kind") != KIND:
        raise FitFileError(f"{path}: not a fit file; expected the output of lieid identify -o")
    try:
        return msgspec.convert(_migrated(raw, path), Content)
    except msgspec.ValidationError as error:
        raise FitFileError(f"{path}: not a usable fit: {reason_of(error)}; fit again") from None


def _bytes(path: Path) -> bytes:
    try:
        with path.open("rb") as file:
            data = file.read(LARGEST_FILE + 1)
    except FileNotFoundError:
        raise FitFileError(f"{path}: no such file") from None
    except OSError as error:
        raise FitFileError(f"{path}: cannot be read: {error.strerror}") from None
    if len(data) > LARGEST_FILE:
        raise FitFileError(
            f"{path}: larger than {LARGEST_FILE >> 20} MB; expected the output of lieid identify -o"
        )
    return data


def _not_json(data: bytes, error: Exception) -> str:
    """Return what is wrong with a text that is not JSON, and where."""
    if data and not data.lstrip().startswith((b"{", b"[")):
        return "not JSON; expected a fit, the output of lieid identify -o"
    if isinstance(error, UnicodeDecodeError):
        return "not a fit: expected JSON text in UTF-8"
    at = re.search(r"\(byte (\d+)\)", str(error))
    if at is None:
        truncated = "truncated" in str(error).lower()
        return (
            "not JSON: truncated; fit again"
            if truncated
            else f"not JSON: {reason_of(error)}; fit again"
        )
    position = int(at[1])
    line = data.count(b"\n", 0, position) + 1
    column = position - (data.rfind(b"\n", 0, position) + 1) + 1
    found = data[position : position + 12].decode("utf-8", "replace").split()
    return (
        f"not JSON at line {line}, column {column}: found {(found or [''])[0]!r}; expected JSON "
        "with finite numbers, fit again"
    )


def _migrated(raw: dict[str, Any], path: Path) -> dict[str, Any]:
    schema = raw.get("schema")
    if type(schema) is not int:
        raise FitFileError(f"{path}: no schema number; expected a whole number up to {SCHEMA}")
    if schema > SCHEMA:
        raise FitFileError(
            f"{path}: schema {schema} is newer than {SCHEMA}, the newest supported by this "
            "version; update lieid-casadi"
        )
    while schema < SCHEMA:
        if schema not in MIGRATIONS:
            raise FitFileError(f"{path}: schema {schema} is unknown; expected 1 to {SCHEMA}")
        raw = MIGRATIONS[schema](raw)
        schema += 1
    return raw


def _with_residual_noise(raw: dict[str, Any]) -> dict[str, Any]:
    """Schema 1 stored the residual's standard deviation without its correlation in time."""
    noise = raw.get("noise")
    sizes = noise if isinstance(noise, list) else []
    residual_noise = [{"filter": [1.0], "sigma": s, "spread": s} for s in sizes]
    return raw | {"schema": 2, "residual_noise": residual_noise}


def _with_reading(raw: dict[str, Any]) -> dict[str, Any]:
    """Schema 2 stored neither torque constants nor units of the training recordings."""
    provenance = raw.get("provenance")
    if isinstance(provenance, dict):
        provenance = {"torque_constants": None, "units": []} | provenance
    return raw | {"schema": 3, "provenance": provenance}


MIGRATIONS: dict[int, Callable[[dict[str, Any]], dict[str, Any]]] = {
    1: _with_residual_noise,
    2: _with_reading,
}
