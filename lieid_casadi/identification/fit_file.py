"""Fit files: JSON with a schema version, the robot inside, written atomically.

A file is data. Effects are looked up by name among those registered; nothing is executed.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
from numpy.typing import NDArray

import lieid_casadi.errors as causes
from lieid_casadi.atomic_file import atomic_binary
from lieid_casadi.errors import FitFileError, LieidWarning, RobotError
from lieid_casadi.identification.feasible.certificate import Certificate
from lieid_casadi.identification.fit import Fit, Provenance, warning_list
from lieid_casadi.identification.regression.conditioning import Conditioning
from lieid_casadi.identification.uncertainty.noise_model import Noise
from lieid_casadi.model import Model
from lieid_casadi.recording.processing.process import Processing
from lieid_casadi.robot.robot import Robot

SCHEMA = 2
KIND = "lieid-fit"
Array = NDArray[np.float64]


def _with_residual_noise(raw: dict[str, Any]) -> dict[str, Any]:
    """Schema 1 had the residual's size and not its memory."""
    noise = [{"filter": [1.0], "sigma": s, "spread": s} for s in raw.get("noise", [])]
    return raw | {"schema": 2, "residual_noise": noise}


MIGRATIONS: dict[int, Callable[[dict[str, Any]], dict[str, Any]]] = {1: _with_residual_noise}


class RobotText(msgspec.Struct, forbid_unknown_fields=True):
    """The robot's own file."""

    kind: str
    text: str
    tip: str | None
    lock: list[str]


class NoiseFile(msgspec.Struct, forbid_unknown_fields=True):
    """The noise of one joint's residual."""

    filter: list[float]
    sigma: float
    spread: float
    rises: float = 1.0


class Content(msgspec.Struct, forbid_unknown_fields=True):
    """Everything in a fit file."""

    kind: str
    schema: int
    robot: RobotText
    effects: list[str]
    method: str
    names: list[str]
    values: list[float]
    shapes: list[float]
    std: list[float | None]
    covariance: list[list[float | None]]
    parameters: list[float]
    noise: list[float]
    residual_noise: list[NoiseFile]
    rms_train: list[float]
    rms_train_raw: list[float]
    rms_cv: list[float | None]
    processing: dict[str, Any]
    conditioning: dict[str, float]
    warnings: list[dict[str, str]]
    provenance: dict[str, Any]
    temperature_mean: list[float] | None
    certificate: dict[str, Any] | None = None


def save(fit: Fit, path: str | Path) -> None:
    """Write a fit; an existing file is replaced as a whole or not at all."""
    with atomic_binary(path) as file:
        file.write(content_of(fit))


def content_of(fit: Fit) -> bytes:
    """Return the content of a fit file."""
    content = Content(
        kind=KIND,
        schema=SCHEMA,
        robot=_robot_text(fit.model.robot),
        effects=[p.label for p in fit.model.placements],
        method=fit.method,
        names=[p.label for p in fit.fitted],
        values=fit.values.tolist(),
        shapes=fit.shapes.tolist(),
        std=_nullable(fit.std),
        covariance=[_nullable(row) for row in fit.covariance],
        parameters=fit.parameters.tolist(),
        noise=fit.noise.tolist(),
        residual_noise=[
            NoiseFile(e.filter.tolist(), e.sigma, e.spread, e.rises) for e in fit.residual_noise
        ],
        rms_train=fit.rms_train.tolist(),
        rms_train_raw=fit.rms_train_raw.tolist(),
        rms_cv=_nullable(fit.rms_cv),
        processing=asdict(fit.processing),
        conditioning=asdict(fit.conditioning),
        warnings=warning_list(fit.warnings),
        provenance=asdict(fit.provenance),
        temperature_mean=None if fit.temperature_mean is None else fit.temperature_mean.tolist(),
        certificate=None if fit.certificate is None else fit.certificate.to_dict(),
    )
    text = json.dumps(msgspec.to_builtins(content), indent=1, allow_nan=False, ensure_ascii=False)
    # names of files may have bytes that are not UTF-8; JSON keeps them as \udcXX
    return text.encode(errors="backslashreplace")


def load(path: str | Path) -> Fit:
    """Read a fit; see `Fit.load` for the errors."""
    content = _content(Path(path))
    try:
        robot = _robot(content.robot, str(path))
        model = Model(robot, content.effects)
        options = msgspec.convert(content.processing, _ProcessingFile)
        fit = Fit(
            model=model,
            method=content.method,
            values=np.array(content.values),
            shapes=np.array(content.shapes),
            covariance=_matrix(content.covariance),
            parameters=np.array(content.parameters),
            noise=np.array(content.noise),
            residual_noise=tuple(
                Noise(np.array(e.filter), e.sigma, e.spread, e.rises)
                for e in content.residual_noise
            ),
            rms_train=np.array(content.rms_train),
            rms_train_raw=np.array(content.rms_train_raw),
            rms_cv=np.array([np.nan if x is None else x for x in content.rms_cv]),
            processing=Processing(**msgspec.to_builtins(options)),
            conditioning=Conditioning(**content.conditioning),
            warnings=tuple(_warning(w) for w in content.warnings),
            provenance=msgspec.convert(content.provenance, Provenance),
            temperature_mean=(
                None if content.temperature_mean is None else np.array(content.temperature_mean)
            ),
            certificate=(
                None if content.certificate is None else Certificate.from_dict(content.certificate)
            ),
        )
    except RobotError as error:
        raise FitFileError(f"{path}: robot inside the fit: {error}") from None
    except (msgspec.ValidationError, TypeError, KeyError) as error:
        raise FitFileError(f"{path}: not a usable fit: {error}") from None
    _check_sizes(fit, content, path)
    return fit


class _ProcessingFile(msgspec.Struct, forbid_unknown_fields=True):
    cutoff: float
    trim: float
    order: int
    average_periods: bool
    smoother: str


def _content(path: Path) -> Content:
    try:
        raw = json.loads(path.read_text(encoding="utf-8"), parse_constant=_refuse_constant)
    except FileNotFoundError:
        raise FitFileError(f"{path}: no such file") from None
    except OSError as error:
        raise FitFileError(f"{path}: cannot be read: {error.strerror}") from None
    except UnicodeDecodeError:
        raise FitFileError(f"{path}: not a fit: expected JSON text") from None
    except json.JSONDecodeError as error:
        raise FitFileError(
            f"{path}: not JSON at line {error.lineno}: {error.msg}; truncated? fit again"
        ) from None
    except _NotFinite as error:
        raise FitFileError(f"{path}: holds {error}; expected finite numbers, fit again") from None
    if not isinstance(raw, dict) or raw.get("kind") != KIND:
        raise FitFileError(f"{path}: not a fit file; expected the output of lieid identify -o")
    raw = _migrated(raw, path)
    try:
        return msgspec.convert(raw, Content)
    except msgspec.ValidationError as error:
        raise FitFileError(f"{path}: not a usable fit: {error}") from None


def _migrated(raw: dict[str, Any], path: Path) -> dict[str, Any]:
    schema = raw.get("schema")
    if not isinstance(schema, int):
        raise FitFileError(f"{path}: schema is {schema!r}; expected a whole number")
    if schema > SCHEMA:
        raise FitFileError(
            f"{path}: schema {schema} is newer than {SCHEMA}, the newest known here; "
            "update lieid-casadi"
        )
    while schema < SCHEMA:
        if schema not in MIGRATIONS:
            raise FitFileError(f"{path}: schema {schema} is unknown; expected {SCHEMA}")
        raw = MIGRATIONS[schema](raw)
        schema += 1
    return raw


class _NotFinite(ValueError):
    pass


def _refuse_constant(name: str) -> float:
    raise _NotFinite(name)


def _check_sizes(fit: Fit, content: Content, path: str | Path) -> None:
    names = [p.label for p in fit.fitted]
    if names != content.names:
        raise FitFileError(
            f"{path}: its parameters are not those that this version derives for its robot and "
            "effects; fit again"
        )
    total, n = len(names), fit.model.n
    expected = {
        "values": (fit.values, (fit.model.base.count,)),
        "shapes": (fit.shapes, (len(fit.model.shapes),)),
        "covariance": (fit.covariance, (total, total)),
        "parameters": (fit.parameters, (10 * n + len(fit.model.columns),)),
        "noise": (fit.noise, (n,)),
        "rms_train": (fit.rms_train, (n,)),
        "rms_train_raw": (fit.rms_train_raw, (n,)),
        "rms_cv": (fit.rms_cv, (n,)),
    }
    for name, (array, shape) in expected.items():
        if array.shape != shape:
            raise FitFileError(f"{path}: {name} has shape {array.shape}; expected {shape}")


def _robot_text(robot: Robot) -> RobotText:
    if robot.source is not None:
        s = robot.source
        return RobotText(s.kind, s.text, s.tip, list(s.lock))
    from lieid_casadi.robot.yaml_file import write_yaml

    return RobotText("yaml", write_yaml(robot), None, [])


def _robot(file: RobotText, origin: str) -> Robot:
    from lieid_casadi.robot.urdf import parse_urdf
    from lieid_casadi.robot.yaml_file import parse_yaml

    if file.kind == "urdf":
        return parse_urdf(file.text, tip=file.tip, lock=file.lock, origin=origin)
    if file.kind == "yaml":
        return parse_yaml(file.text, origin=origin)
    raise FitFileError(f"{origin}: robot of kind {file.kind!r}; expected urdf or yaml")


def _warning(item: dict[str, str]) -> LieidWarning:
    kind = getattr(causes, item["name"], LieidWarning)
    if not (isinstance(kind, type) and issubclass(kind, LieidWarning)):
        kind = LieidWarning
    return kind(item["message"])


def _nullable(row: Array) -> list[float | None]:
    return [float(x) if np.isfinite(x) else None for x in row]


def _matrix(rows: list[list[float | None]]) -> Array:
    if any(len(row) != len(rows) for row in rows):
        raise FitFileError("covariance is not square")
    return np.array([[np.nan if x is None else x for x in row] for row in rows]).reshape(
        len(rows), len(rows)
    )
