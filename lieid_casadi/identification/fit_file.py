"""Fit files: JSON with a schema version and the robot inside, written atomically.

Every entry has its type here, so that a file is either valid or refused with the path of the entry
that is not; older schemas are migrated. A file is data: effects are looked up by name among those
registered, and nothing is executed.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import fields, is_dataclass, replace
from pathlib import Path
from typing import Annotated, Any

import msgspec
import numpy as np
from msgspec import Meta, Struct

import lieid_casadi.errors as errors
from lieid_casadi.arrays import Array
from lieid_casadi.atomic_file import read_limited
from lieid_casadi.errors import EffectError, FitFileError, LieidError, LieidWarning, warning_list
from lieid_casadi.identification.feasible.certificate import Certificate
from lieid_casadi.identification.recording_checks import Provenance
from lieid_casadi.identification.regression.least_squares import Conditioning
from lieid_casadi.identification.uncertainty.noise_model import Noise
from lieid_casadi.json_numbers import number_or_none
from lieid_casadi.messages import reason_of
from lieid_casadi.model import Model
from lieid_casadi.recording.processed import Processing
from lieid_casadi.robot.description import STANDARD_GRAVITY, RobotSource
from lieid_casadi.robot.drive import Drive
from lieid_casadi.robot.robot import Robot
from lieid_casadi.robot.yaml_file import write_yaml


def file_content(own: Mapping[str, Any], *, names: Sequence[str], std: Array) -> bytes:
    """Return a fit file with the fields of a `Fit`, the names of its numbers and their ``std``."""
    model: Model = own["model"]
    raw = {name: _plain(value) for name, value in own.items() if name != "model"}
    raw |= {
        "kind": KIND,
        "schema": SCHEMA,
        "robot": _robot_text(model.robot),
        "effects": [p.label for p in model.placements],
        "names": list(names),
        "std": _plain(std),
        "warnings": warning_list(own["warnings"]),
        "residual_noise": [
            {
                "filter": e.filter.tolist(),
                "sigma": e.sigma,
                "spread": e.spread,
                "rises": e.motion_ratio,
            }
            for e in own["residual_noise"]
        ],
    }
    content = msgspec.to_builtins(msgspec.convert(raw, Content))
    text = json.dumps(content, indent=1, allow_nan=False, ensure_ascii=False)
    return text.encode(errors="replace")  # names of files can have bytes that are not UTF-8


def _plain(value: Any) -> Any:
    """Return arrays and dataclasses as JSON has them, None in place of NaN and infinity."""
    if is_dataclass(value):
        return {field.name: _plain(getattr(value, field.name)) for field in fields(value)}
    if isinstance(value, np.ndarray | tuple):
        return [_plain(part) for part in value]
    return number_or_none(value) if isinstance(value, float) else value


def read_fields(path: str | Path) -> dict[str, Any]:
    """Return the fields of `Fit` that a file holds; see `Fit.load` for the errors."""
    content = read_content(Path(path))
    try:
        model = Model(_robot(content.robot), content.effects)
        _check_sizes(model, content)
    except EffectError as error:  # names an effect that is not registered
        raise EffectError(f"{path}: {error}") from None
    except LieidError as error:
        raise FitFileError(f"{path}: {reason_of(error)}") from None
    intervals, certificate = _array(content.shape_intervals), content.certificate
    return {
        **{name: _array(getattr(content, name)) for name in ARRAYS},
        "model": model,
        "method": content.method,
        "residual_noise": tuple(
            Noise(np.array(e.filter), e.sigma, e.spread, e.rises) for e in content.residual_noise
        ),
        "processing": content.processing,
        "conditioning": content.conditioning,
        "warnings": tuple(_warning(w) for w in content.warnings),
        "provenance": content.provenance,
        "shape_intervals": None if intervals is None else intervals.reshape(-1, 2),
        "certificate": (
            None if certificate is None else Certificate.from_dict(msgspec.to_builtins(certificate))
        ),
    }


ARRAYS = (
    "values", "shapes", "covariance", "parameters", "noise",
    "rms_train", "rms_train_raw", "rms_cv", "temperature_mean",
)  # fmt: skip


def _array(numbers: list[Any] | None) -> Array | None:
    """Return numbers as an array, with NaN for None."""
    return None if numbers is None else np.array(numbers, dtype=float)


def _check_sizes(model: Model, content: Content) -> None:
    """Raise `FitFileError` where lists do not have the model's sizes, or variances are negative."""
    fitted = [*model.base_columns, *model.shapes]
    names = [p.label for p in fitted]
    # version 0.2 left out the joint whose motion acts, of a coupling
    if content.names not in (names, [name.partition("<")[0] for name in names]):
        raise FitFileError(
            "its parameters are not those that this version derives for its robot and effects; "
            "fit again"
        )
    if content.processing.cutoff is None:
        raise FitFileError("processing has no cutoff; fit again")
    total, n, shapes = len(fitted), model.n, len(model.shapes)
    per_joint = ("noise", "residual_noise", "rms_train", "rms_train_raw", "rms_cv")
    sizes = {
        "values": (content.values, model.base.count),
        "shapes": (content.shapes, shapes),
        "std": (content.std, total),
        "covariance": (content.covariance, total),
        "parameters": (content.parameters, 10 * n + len(model.columns)),
        **{name: (getattr(content, name), n) for name in per_joint},
        **{f"covariance[{k}]": (row, total) for k, row in enumerate(content.covariance)},
        "temperature_mean": (content.temperature_mean, n),
        "shape_intervals": (content.shape_intervals, shapes),
        **{
            f"certificate.{name}": (getattr(content.certificate, name, None), n)
            for name in (
                "pseudo_inertia_eigenvalue",
                "divergence",
                "rms",
                "rms_wls",
                "gravity",
                "stated_gravity",
            )
        },
        "torque_constants": (content.provenance.torque_constants, n),
    }
    for name, (numbers, size) in sizes.items():
        if numbers is not None and len(numbers) != size:
            raise FitFileError(f"{name} has {len(numbers)} entries; expected {size}, fit again")
    for k, row in enumerate(content.covariance):
        variance = row[k]
        if variance is not None and variance < 0.0:
            raise FitFileError(
                f"covariance[{k}][{k}], the variance of {content.names[k]}, is {variance:g}; "
                "expected 0 or more, fit again"
            )


def _robot_text(robot: Robot) -> dict[str, Any]:
    """Return the robot's own file, or YAML, with what it does not state; see `RobotText`."""
    drives = [_plain(drive) for drive in robot.drives or ()]
    s = robot.source
    if s is None or s.kind == "mjcf":
        files = None if s is None else {"files": s.files, "carried": s.carried}
        return {
            "kind": "yaml",
            "text": write_yaml(robot),
            "tip": None if s is None else s.tip,
            "lock": [] if s is None else list(s.lock),
            "drives": drives,
            "mjcf": files,
        }
    text = {"kind": s.kind, "text": s.text, "tip": s.tip, "lock": list(s.lock), "drives": drives}
    if s.kind == "urdf" and not np.array_equal(robot.gravity, STANDARD_GRAVITY):
        text["gravity"] = [float(x) for x in robot.gravity]
    return text


def _robot(file: RobotText) -> Robot:
    robot = _described(file)
    if file.gravity is not None:
        if len(file.gravity) != 3:
            raise FitFileError(f"gravity has {len(file.gravity)} entries; expected 3, fit again")
        robot = replace(robot, gravity=np.array(file.gravity))
    laws: list[dict[str, Any]] = [
        {name: math.inf if value is None else value for name, value in law.items()}
        for law in msgspec.to_builtins(file.drives)
    ]
    drives = [Drive(**law) for law in laws]
    return robot.with_drives(drives) if drives else robot


def _described(file: RobotText) -> Robot:
    origin = "robot inside the fit"
    if file.kind == "urdf":
        return Robot.parse_urdf(file.text, tip=file.tip, lock=file.lock, origin=origin)
    if file.kind == "yaml":
        robot = Robot.parse_yaml(file.text, origin=origin)
        return robot if file.mjcf is None else replace(robot, source=_model(file, robot.n))
    raise FitFileError(f"robot of kind {file.kind[:20]!r}; expected urdf or yaml")


def _model(file: RobotText, n: int) -> RobotSource:
    own = file.mjcf
    if own is None or not own.files or [len(row) for _, row in own.carried] != [10] * n:
        raise FitFileError("the MuJoCo model inside does not belong to its robot, fit again")
    carried = tuple((body, tuple(float(x) for x in row)) for body, row in own.carried)
    files = tuple(own.files)
    return RobotSource("mjcf", files[0][1], file.tip, tuple(file.lock), files, carried)


def _warning(item: WarningFile) -> LieidWarning:
    kind = getattr(errors, item.name, LieidWarning)
    if not (isinstance(kind, type) and issubclass(kind, LieidWarning)):
        kind = LieidWarning
    return kind(item.message)


SCHEMA = 5
KIND = "lieid-fit"
LARGEST_FILE = 64 << 20  # bytes; a fit of ten joints with all effects has less than 1 MB

LARGEST = 1e100  # of any number: its square is finite
Number = Annotated[float, Meta(ge=-LARGEST, le=LARGEST)]
Positive = Annotated[float, Meta(ge=1.0 / LARGEST, le=LARGEST)]
NotNegative = Annotated[float, Meta(ge=0.0, le=LARGEST)]


class DriveFile(Struct, forbid_unknown_fields=True, omit_defaults=True):
    """Control law of one joint; limits are left out where there are none."""

    stiffness: Positive
    damping: NotNegative
    proportional_limit: Positive | None
    torque_limit: Positive | None
    relative: bool
    servo: str
    derivative: NotNegative = 0.0
    overload: Positive | None = None
    overload_time: NotNegative = 0.0
    protective_limit: Positive | None = None


class ModelFiles(Struct, forbid_unknown_fields=True):
    """A MuJoCo model: names and texts of its files, and what moves with each joint's body."""

    files: list[tuple[str, str]]
    carried: list[tuple[str, list[Number]]]


class RobotText(Struct, forbid_unknown_fields=True, omit_defaults=True):
    """The robot's own file, and what it does not state: the drives' laws, and the mounting.

    ``gravity`` (3,) is left out where it is that of the file. A robot from a MuJoCo model is
    written as YAML, with the model beside it for exports.
    """

    kind: str
    text: str
    tip: str | None
    lock: list[str]
    drives: list[DriveFile] = []
    gravity: list[Number] | None = None
    mjcf: ModelFiles | None = None


class NoiseFile(Struct, forbid_unknown_fields=True):
    """Noise of one joint's residual."""

    filter: Annotated[list[Number], Meta(min_length=1, max_length=100)]
    sigma: Positive
    spread: Positive
    rises: Annotated[float, Meta(ge=1.0, le=LARGEST)] = 1.0  # `Noise.motion_ratio`


class WarningFile(Struct, forbid_unknown_fields=True):
    """A warning: its class and its text."""

    name: str
    message: str


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
    gravity: list[NotNegative] | None = None
    stated_gravity: list[NotNegative] | None = None


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
    processing: Processing
    conditioning: Conditioning
    warnings: list[WarningFile]
    provenance: Provenance
    temperature_mean: list[Number] | None
    shape_intervals: list[Annotated[list[Number | None], Meta(min_length=2, max_length=2)]] | None
    certificate: CertificateFile | None = None


def read_content(path: Path) -> Content:
    """Return the content of a fit file, migrated to the present schema."""
    data = read_limited(path, LARGEST_FILE, FitFileError, "the output of lieid identify -o")
    try:
        raw = msgspec.json.decode(data)
    except RecursionError:
        raise FitFileError(f"{path}: not a fit: nested too deeply") from None
    except (msgspec.MsgspecError, UnicodeDecodeError) as error:
        # within a number, the parser finds the number wrong
        cut = data.startswith(b"{") and not data.rstrip().endswith(b"}")
        reason = "the file is truncated" if cut else reason_of(error)
        raise FitFileError(
            f"{path}: not JSON; expected a fit, the output of lieid identify -o: {reason}"
        ) from None
    if not isinstance(raw, dict) or raw.get("kind") != KIND:
        raise FitFileError(f"{path}: not a fit file; expected the output of lieid identify -o")
    try:
        return msgspec.convert(_migrated(raw, path), Content)
    except msgspec.ValidationError as error:
        raise FitFileError(f"{path}: not a usable fit: {reason_of(error)}; fit again") from None


def _migrated(raw: dict[str, Any], path: Path) -> dict[str, Any]:
    schema = raw.get("schema")
    if type(schema) is not int:
        raise FitFileError(f"{path}: no schema number; expected a whole number up to {SCHEMA}")
    if schema > SCHEMA:
        raise FitFileError(
            f"{path}: schema {schema} is newer than {SCHEMA}, the newest supported by this "
            "version; update lieid-casadi"
        )
    if schema < 1:
        raise FitFileError(f"{path}: schema {schema} is unknown; expected 1 to {SCHEMA}")
    missing = dict[str, Any]()
    if schema < 2:  # stored the residual's standard deviation without its correlation in time
        noise = raw.get("noise")
        sizes = noise if isinstance(noise, list) else []
        missing["residual_noise"] = [{"filter": [1.0], "sigma": x, "spread": x} for x in sizes]
    if schema < 4:  # stored no intervals of shape parameters
        missing["shape_intervals"] = None
    processing = raw.get("processing")
    if schema < 5 and isinstance(processing, dict):  # stored options that ended
        missing["processing"] = {name: processing.get(name) for name in ("cutoff", "trim")}
    return raw | missing | {"schema": SCHEMA}
