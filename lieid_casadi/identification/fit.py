"""A fitted model: numbers, their covariance, and where they came from."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from lieid_casadi.compiled import Compiled, compile
from lieid_casadi.errors import EffectError, LieidWarning, ModelError
from lieid_casadi.identification.feasible.certificate import Certificate
from lieid_casadi.identification.regression.conditioning import Conditioning
from lieid_casadi.identification.uncertainty.noise_model import Noise
from lieid_casadi.model import Model, Parameter
from lieid_casadi.recording.processing.process import Processed, Processing
from lieid_casadi.recording.recording import Recording
from lieid_casadi.robot.inertia import pseudo_inertia

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from lieid_casadi.identification.uncertainty.prediction_band import PredictionBand

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Source:
    """One recording that went into a fit."""

    name: str
    sha256: str


@dataclass(frozen=True)
class Provenance:
    """What made a fit: the package's version and the data."""

    version: str
    recordings: tuple[Source, ...]


@dataclass(frozen=True, eq=False)
class Fit:
    """Result of :func:`lieid_casadi.identify`.

    Attributes
    ----------
    model : Model
    method : str
        ``ols``, ``wls``, ``robust`` or ``feasible``.
    values : (p,)
        Base parameters β, as ``model.base_columns``.
    shapes : (s,)
        Shape parameters, as ``model.shapes``.
    covariance : (p + s, p + s)
        Of values and shapes, allowing for residuals correlated in time. For ``feasible`` it is
        that of weighted least squares: constraints and the pull towards the nominal bodies only
        make the scatter smaller, in exchange for a bias that no covariance shows.
    parameters : (10 n + m,)
        Link parameters and effect coefficients that give ``values``: physically possible ones
        for ``feasible``, else those nearest to the robot's nominal ones.
    noise : (n,)
        Standard deviation of the residual per joint, N·m.
    residual_noise : tuple of Noise
        Of each joint: the residual's size and memory, where dry friction is not in doubt.
    rms_train, rms_train_raw : (n,)
        Error on the training recordings, N·m: measured and predicted through the same filter,
        and raw, that is resampled to a uniform grid but not filtered.
    rms_cv : (n,)
        Error on held-out blocks of the training recordings, joints in motion, N·m.
    processing : Processing
        With the cut-off filled in.
    conditioning : Conditioning
    warnings : tuple of LieidWarning
    provenance : Provenance
    temperature_mean : (n,) or None
        °C of the training recordings, which temperature effects refer to.
    certificate : Certificate or None
        Of the method ``feasible``: what is certain of its parameters, and what they cost.
    """

    model: Model
    method: str
    values: Array
    shapes: Array
    covariance: Array
    parameters: Array
    noise: Array
    residual_noise: tuple[Noise, ...]
    rms_train: Array
    rms_train_raw: Array
    rms_cv: Array
    processing: Processing
    conditioning: Conditioning
    warnings: tuple[LieidWarning, ...]
    provenance: Provenance
    temperature_mean: Array | None = None
    certificate: Certificate | None = None

    @cached_property
    def compiled(self) -> Compiled:
        """The model's functions for batches of samples."""
        return compile(self.model)

    @property
    def std(self) -> Array:
        """Standard deviations of values and shapes (p + s,)."""
        return np.sqrt(np.diag(self.covariance))

    @property
    def link_parameters(self) -> Array:
        """Link parameters (10 n,), nearest to the nominal ones among those that fit alike."""
        return self.parameters[: 10 * self.model.n]

    @property
    def effect_coefficients(self) -> Array:
        """Linear coefficients of the effects (m,), dropped ones included."""
        return self.parameters[10 * self.model.n :]

    @property
    def physically_consistent(self) -> bool:
        """Whether every link's pseudo-inertia is positive definite."""
        links = self.link_parameters.reshape(-1, 10)
        return bool(all(np.linalg.eigvalsh(pseudo_inertia(link))[0] > 0.0 for link in links))

    @property
    def fitted(self) -> tuple[Parameter, ...]:
        """Base parameters, then shapes: what ``values`` and ``shapes`` are."""
        return (*self.model.base_columns, *self.model.shapes)

    def predict(self, recording: Recording) -> Array:
        """Return the torque (N, n) at the recording's own times, N·m; finite everywhere.

        Raises
        ------
        ModelError
            If the recording has another number of joints.
        EffectError
            If an effect needs a temperature that the recording lacks.
        """
        from lieid_casadi.identification.prediction import predict_recording

        self.check_joints(recording)
        return predict_recording(
            self.compiled,
            recording,
            self.processing,
            self.parameters,
            self.shapes,
            self.temperature_mean,
        )

    def predict_band(self, recording: Recording, *, level: float = 0.95) -> PredictionBand:
        """Return the torque with the band that holds a measured sample with probability ``level``.

        See `lieid_casadi.identification.uncertainty.prediction_band.predict_band`.
        """
        from lieid_casadi.identification.uncertainty.prediction_band import predict_band

        return predict_band(self, recording, level=level)

    def predict_processed(self, segment: Processed) -> Array:
        """Return the filtered torque (M, n) of a segment as `process` returns it."""
        from lieid_casadi.identification.prediction import relative_temperature, torque_along

        segment = relative_temperature(segment, self.temperature_mean)
        torque = torque_along(self.compiled, segment, self.parameters, self.shapes)
        return segment.filter(torque)

    def check_joints(self, recording: Recording) -> None:
        """Raise `ModelError` or `EffectError` if a recording lacks joints or temperatures."""
        if recording.n != self.model.n:
            raise ModelError(
                f"{recording.name or 'recording'}: {recording.n} joints; "
                f"the fit of {self.model.robot.name!r} has {self.model.n}"
            )
        warm = [p.label for p in self.model.placements if "temperature" in p.effect.signals]
        if warm and recording.temperature is None:
            raise EffectError(
                f"{recording.name or 'recording'}: {warm[0]} needs temperature; expected columns "
                f"temp1…temp{self.model.n}"
            )

    def save(self, path: str | Path) -> None:
        """Write the fit as JSON, atomically; it embeds the robot and stands alone."""
        from lieid_casadi.identification.fit_file import save

        save(self, path)

    @classmethod
    def load(cls, path: str | Path) -> Fit:
        """Read a fit from JSON. Nothing in the file is executed.

        Raises
        ------
        FitFileError
            Missing, truncated, not finite, or of a newer schema.
        EffectError
            It names an effect that is not registered.
        """
        from lieid_casadi.identification.fit_file import load

        return load(path)

    def parameter_table(self) -> list[dict[str, Any]]:
        """Return one row per fitted number: name, joint (from 1), value, std, unit.

        ``relative_std`` is std/|value|, None where it is not finite.
        """
        numbers = np.concatenate([self.values, self.shapes])
        expressions = [self.model.base.expression(k) for k in range(len(self.values))]
        expressions += [shape.name for shape in self.model.shapes]
        return [
            {
                "name": parameter.name,
                "joint": parameter.joint + 1,
                "value": float(value),
                "std": float(std) if np.isfinite(std) else None,
                "relative_std": float(std / abs(value)) if value and np.isfinite(std) else None,
                "unit": parameter.unit,
                "expression": expression,
            }
            for parameter, value, std, expression in zip(
                self.fitted, numbers, self.std, expressions, strict=True
            )
        ]

    def ranking(self) -> list[dict[str, Any]]:
        """Return the rows of `parameter_table`, the parameter that the data knows best first.

        By relative standard deviation; above about 0.3 a value says little more than its sign.
        """
        last = float("inf")

        def key(row: dict[str, Any]) -> float:
            return last if row["relative_std"] is None else float(row["relative_std"])

        return sorted(self.parameter_table(), key=key)

    def plot(self, ax: Axes | None = None) -> Figure:
        """Draw how well each parameter is known; return the figure, not shown."""
        from lieid_casadi.identification.fit_view import plot

        return plot(self, ax)

    def _repr_html_(self) -> str:
        from lieid_casadi.identification.fit_view import html

        return html(self)

    def __repr__(self) -> str:
        return (
            f"<Fit of {self.model.robot.name}: {', '.join(self.model.effects) or 'rigid'}; "
            f"{len(self.values) + len(self.shapes)} parameters, {self.method}>"
        )

    def to_dict(self) -> dict[str, Any]:
        """Return the keys of ``lieid identify --json`` that need no test recording."""
        condition = self.conditioning.condition_number
        return {
            "robot": self.model.robot.name,
            "effects": self.model.effects,
            "method": self.method,
            "rms_train": self.rms_train.tolist(),
            "rms_train_raw": self.rms_train_raw.tolist(),
            "rms_cv": [float(x) if np.isfinite(x) else None for x in self.rms_cv],
            "cutoff": self.processing.cutoff,
            "warnings": warning_list(self.warnings),
            "base_parameter_count": self.model.base.count,
            "condition_number": condition if np.isfinite(condition) else None,
            "singular_values": {
                "largest": self.conditioning.largest,
                "smallest": self.conditioning.smallest,
                "beyond": self.conditioning.beyond,
            },
            "physically_consistent": self.physically_consistent,
            "certificate": None if self.certificate is None else self.certificate.to_dict(),
            "parameters": self.parameter_table(),
        }


def warning_list(warnings: Sequence[LieidWarning]) -> list[dict[str, str]]:
    """Return warnings as they stand in JSON: ``[{name, message}]``."""
    return [{"name": type(w).__name__, "message": str(w)} for w in warnings]
