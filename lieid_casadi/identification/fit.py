"""Result of an identification: parameters, their covariance, errors and origin."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from lieid_casadi.arrays import Array
from lieid_casadi.compiled import Compiled, compile
from lieid_casadi.errors import LieidWarning, warning_list
from lieid_casadi.identification.feasible.certificate import Certificate
from lieid_casadi.identification.prediction import (
    predict_recording,
    relative_temperature,
    sample_torque,
    torque_along,
)
from lieid_casadi.identification.recording_checks import Provenance, check_joints
from lieid_casadi.identification.regression.least_squares import Conditioning
from lieid_casadi.identification.uncertainty.noise_model import Noise
from lieid_casadi.json_numbers import number_or_none, numbers_or_none
from lieid_casadi.model import Model, Parameter
from lieid_casadi.recording.processed import Processed, Processing
from lieid_casadi.recording.recording import Recording
from lieid_casadi.robot.inertia import pseudo_inertia

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from lieid_casadi.identification.uncertainty.prediction_band import PredictionBand

NORMAL_95 = 1.96  # standard deviations of a normal distribution within 95 %


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
        Of values and shapes, with the correlation of the residuals in time accounted for. For
        ``feasible`` it is that of weighted least squares: constraints and regularization towards
        the nominal bodies reduce the variance and add a bias, which a covariance does not show.
    parameters : (10 n + m,)
        Link parameters and effect coefficients that give ``values``: physically consistent for
        ``feasible``, otherwise those nearest to the robot's nominal ones.
    noise : (n,)
        Standard deviation of the residual per joint, N·m.
    residual_noise : tuple of Noise
        Of each joint: size and correlation in time of the residual, without the uncertainty of
        dry friction near velocity reversals.
    rms_train, rms_train_raw : (n,)
        RMS error on the training recordings, N·m: of measured and predicted torque through the
        same filter, and raw (resampled to a uniform grid, not filtered).
    rms_cv : (n,)
        RMS error on held-out blocks of the training recordings, joints in motion, N·m.
    processing : Processing
        Filter options, with the cut-off that was used.
    conditioning : Conditioning
    warnings : tuple of LieidWarning
    provenance : Provenance
    temperature_mean : (n,) or None
        Mean temperatures of the training recordings, °C, to which temperature effects refer.
    shape_intervals : (s, 2) or None
        Bounds of each shape with a probability of 95 %, from the profile of the weighted error;
        NaN for shapes that the recordings give. None if the shapes were held.
    certificate : Certificate or None
        Of the method ``feasible``: checks of physical consistency, and the increase in error.
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
    shape_intervals: Array | None = None

    @cached_property
    def compiled(self) -> Compiled:
        """The model's functions for batches of samples."""
        return compile(self.model)

    @property
    def std(self) -> Array:
        """Standard deviations of values and shapes (p + s,).

        That of a shape is the half width of its interval over 1.96, where the fit has one.
        """
        std = np.sqrt(np.diag(self.covariance))
        if self.shape_intervals is not None:
            half = 0.5 * np.diff(self.shape_intervals, axis=1)[:, 0] / NORMAL_95
            std[len(self.values) :] = np.where(np.isfinite(half), half, std[len(self.values) :])
        return std

    @property
    def link_parameters(self) -> Array:
        """Link parameters (10 n,): of all that fit equally well, those nearest to the nominal."""
        return self.parameters[: 10 * self.model.n]

    @property
    def effect_coefficients(self) -> Array:
        """Linear coefficients of the effects (m,), including those that are not base parameters."""
        return self.parameters[10 * self.model.n :]

    @property
    def physically_consistent(self) -> bool:
        """Whether every link's pseudo-inertia is positive definite."""
        links = self.link_parameters.reshape(-1, 10)
        return bool(all(np.linalg.eigvalsh(pseudo_inertia(link))[0] > 0.0 for link in links))

    @property
    def fitted(self) -> tuple[Parameter, ...]:
        """Base parameters, then shape parameters: the entries of ``values`` and ``shapes``."""
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
        self.check_joints(recording)
        return predict_recording(
            self.compiled,
            recording,
            self.processing,
            self.parameters,
            self.shapes,
            self.temperature_mean,
        )

    def torque(
        self,
        q: ArrayLike,
        dq: ArrayLike,
        ddq: ArrayLike,
        *,
        temperature: ArrayLike | None = None,
        time: ArrayLike | None = None,
    ) -> Array:
        """Return the torque (N, n) at samples: the rigid torque and every effect, N·m.

        No filter and no dead zone is applied. For effects with memory the samples are one
        segment, in order.

        Parameters
        ----------
        q, dq, ddq : (N, n)
            rad, rad/s, rad/s² (m for a sliding joint).
        temperature : (N, n), optional
            °C; for effects of the temperature.
        time : (N,), optional
            s; for effects of time and effects with memory.

        Raises
        ------
        ModelError
            A signal that an effect needs is not given, or an effect depends on the motion before
            the instant (a delay, an elastic joint).
        """
        return sample_torque(self, q, dq, ddq, temperature=temperature, time=time)

    def predict_band(self, recording: Recording, *, level: float = 0.95) -> PredictionBand:
        """Return the torque with bounds that contain a measured sample with probability ``level``.

        See `lieid_casadi.identification.uncertainty.prediction_band.predict_band`.
        """
        from lieid_casadi.identification.uncertainty.prediction_band import predict_band

        return predict_band(self, recording, level=level)

    def sample(self, n: int, *, seed: int = 0) -> tuple[Fit, ...]:
        """Return physically consistent fits drawn from the posterior of this one.

        For ensembles and domain randomisation: masses and inertias are positive definite, friction
        dissipates. The draws state the uncertainty of the parameters, given that the model's
        effects are the right ones; they do not contain noise or errors of the model.

        Parameters
        ----------
        n : int
            How many.
        seed : int
            Of the random numbers.

        Raises
        ------
        IdentificationError
            The fit is not physically consistent (``method="feasible"``), or n is below 1.
        NoSolution
            The solver finds no consistent parameters near the draws.
        """
        from lieid_casadi.identification.uncertainty.posterior_samples import sample_fits

        return sample_fits(self, n, seed=seed)

    def predict_processed(self, segment: Processed) -> Array:
        """Return the filtered torque (M, n) of a segment as `process` returns it."""
        segment = relative_temperature(segment, self.temperature_mean)
        torque = torque_along(self.compiled, segment, self.parameters, self.shapes)
        return segment.filter(torque)

    def check_joints(self, recording: Recording) -> None:
        """Raise `ModelError` or `EffectError` if a recording lacks joints or temperatures."""
        check_joints(self.model, recording)

    def save(self, path: str | Path) -> None:
        """Write the fit as JSON, atomically. The file contains the robot.

        Raises
        ------
        OutputError
            The file cannot be written.
        """
        from lieid_casadi.identification.fit_file import save

        save(self, path)

    @classmethod
    def load(cls, path: str | Path) -> Fit:
        """Read a fit from JSON. Nothing in the file is executed.

        Raises
        ------
        FitFileError
            Missing, truncated, not a fit, of a newer schema, or with an entry that is not valid.
        EffectError
            It names an effect that is not registered.
        """
        from lieid_casadi.identification.fit_file import read_fields

        return cls(**read_fields(path))

    def parameter_table(self) -> list[dict[str, Any]]:
        """Return one row per fitted number: name, joint (from 1), value, std, unit.

        ``relative_std`` is std/|value|, None where it is not finite.
        """
        numbers = np.concatenate([self.values, self.shapes])
        expressions = [self.model.base.expression(k) for k in range(len(self.values))]
        expressions += [shape.label for shape in self.model.shapes]
        return [
            {
                "name": parameter.name,
                "joint": parameter.joint + 1,
                "value": float(value),
                "std": number_or_none(std),
                "relative_std": float(std / abs(value)) if value and np.isfinite(std) else None,
                "unit": parameter.unit,
                "expression": expression,
            }
            for parameter, value, std, expression in zip(
                self.fitted, numbers, self.std, expressions, strict=True
            )
        ]

    def ranking(self) -> list[dict[str, Any]]:
        """Return the rows of `parameter_table` in the order of their relative standard deviation.

        Above about 0.3, little more than the sign of a value is determined.
        """
        last = float("inf")

        def key(row: dict[str, Any]) -> float:
            return last if row["relative_std"] is None else float(row["relative_std"])

        return sorted(self.parameter_table(), key=key)

    def plot(self, ax: Axes | None = None) -> Figure:
        """Draw each parameter relative to its standard deviation; the figure is not shown."""
        from lieid_casadi.identification.fit_view import plot_parameters

        return plot_parameters(self, ax)

    def _repr_html_(self) -> str:
        from lieid_casadi.identification.fit_view import html_view

        return html_view(self)

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
            "rms_cv": numbers_or_none(self.rms_cv),
            "cutoff": self.processing.cutoff,
            "warnings": warning_list(self.warnings),
            "base_parameter_count": self.model.base.count,
            "condition_number": number_or_none(condition),
            "singular_values": {
                "largest": self.conditioning.largest,
                "smallest": self.conditioning.smallest,
                "beyond": self.conditioning.beyond,
            },
            "physically_consistent": self.physically_consistent,
            "certificate": None if self.certificate is None else self.certificate.to_dict(),
            "parameters": self.parameter_table(),
        }
