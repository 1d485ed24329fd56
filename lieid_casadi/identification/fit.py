"""Result of an identification: parameters, their covariance, errors and origin."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, fields, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from lieid_casadi.arrays import Array, Mask
from lieid_casadi.atomic_file import atomic_binary
from lieid_casadi.compiled import Compiled, compile
from lieid_casadi.errors import IdentificationError, LieidWarning, warning_list
from lieid_casadi.identification.feasible.certificate import Certificate
from lieid_casadi.identification.fit_file import file_content, read_fields
from lieid_casadi.identification.prediction import (
    predict_recording,
    relative_temperature,
    torque_along,
)
from lieid_casadi.identification.recording_checks import Provenance, check_joints
from lieid_casadi.identification.regression.least_squares import Conditioning
from lieid_casadi.identification.uncertainty.noise_model import Noise
from lieid_casadi.json_numbers import number_or_none, numbers_or_none
from lieid_casadi.model import Model, Parameter
from lieid_casadi.plot_style import Axes, Figure, drawing
from lieid_casadi.recording.processed import Processed, Processing
from lieid_casadi.recording.recording import Recording
from lieid_casadi.robot.inertia import pseudo_inertia
from lieid_casadi.tables import Table, html, make_table

NORMAL_95 = 1.96  # standard deviations of a normal distribution within 95 %


@dataclass(frozen=True, eq=False)
class Fit:
    """Result of :func:`lieid_casadi.identify`; it predicts, samples and saves itself.

    The covariance accounts for the correlation of the residuals in time. For ``feasible`` it is
    that of weighted least squares: constraints and regularization towards the nominal bodies
    reduce the variance and add a bias, which a covariance does not show.
    """

    model: Model
    method: str  #: ``ols``, ``wls``, ``robust`` or ``feasible``
    values: Array  #: (p,): base parameters β, as ``model.base_columns``
    shapes: Array  #: (s,): shape parameters, as ``model.shapes``
    covariance: Array  #: (p + s, p + s): of values and shapes
    #: (10 n + m,): link parameters and effect coefficients that give ``values``: physically
    #: consistent for ``feasible``, otherwise those nearest to the robot's nominal ones
    parameters: Array
    noise: Array  #: (n,): standard deviation of the residual, N·m
    #: of each joint: size and correlation in time of the residual, without the uncertainty of dry
    #: friction near velocity reversals
    residual_noise: tuple[Noise, ...]
    rms_train: Array  #: (n,): error on the training recordings, filtered torques, N·m
    rms_train_raw: Array  #: (n,): the same on a uniform grid, not filtered, N·m
    rms_cv: Array  #: (n,): on held-out blocks of them, joints in motion, N·m
    processing: Processing  #: filter options, with the cut-off that was used
    conditioning: Conditioning
    warnings: tuple[LieidWarning, ...]
    provenance: Provenance
    temperature_mean: Array | None = None  #: (n,): °C, to which temperature effects refer
    certificate: Certificate | None = None  #: of ``feasible``: physical consistency, and its cost
    #: (s, 2): bounds of each shape with a probability of 95 %, from the profile of the weighted
    #: error; NaN for shapes that the recordings give. None if the shapes were held
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

    @property
    def drifting(self) -> Mask:
        """Marks the base parameters (p,) that hold for the fit's recordings only: of drifts."""
        drifts = [p for p in self.model.placements if p.effect.per_recording]
        return np.array([any(map(p.belongs_to, drifts)) for p in self.model.base_columns], bool)

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

    def sample(
        self,
        n: int,
        *,
        seed: int = 0,
        rivals: Sequence[Fit] = (),
        weights: ArrayLike | None = None,
        progress: Callable[[str, float], None] | None = None,
    ) -> tuple[Fit, ...]:
        """Return physically consistent fits drawn from the posterior of this one and its rivals.

        For ensembles and domain randomisation: masses and inertias are positive definite, friction
        dissipates. The draws state the uncertainty of the parameters, and with ``rivals`` that of
        the effects; they do not contain noise or errors that all of these models have
        (`lieid_casadi.identification.ensemble.ensemble_coverage` compares them with a recording).

        Parameters
        ----------
        n : int
            How many.
        seed : int
            Of the random numbers.
        rivals : sequence of Fit
            Fits of the same robot with other effects, which the recordings do not separate.
        weights : (1 + number of rivals,), optional
            Probabilities of this fit and its rivals, in proportion; equal if left out. Those by
            the errors on a recording are `lieid_casadi.identification.ensemble.model_weights`.
        progress : callable, optional
            Called with a stage's name and the fraction done.

        Raises
        ------
        IdentificationError
            A fit is not physically consistent (``method="feasible"``) or of another robot, n is
            below 1, or weights do not match.
        NoSolution
            The solver finds no consistent parameters near the draws.
        """
        fits = (self, *rivals)
        counts, random = np.array([n]), np.random.default_rng(seed)
        if n < 1:
            raise IdentificationError(f"got {n} samples; expected at least 1")
        if rivals:
            counts = random.multinomial(n, self._shares(fits, weights))
        report, found = progress or (lambda stage, fraction: None), list[Fit]()
        for fit, count in zip(fits, counts, strict=True):
            for drawn in fit._draws(int(count), seed=seed):
                found.append(drawn)
                report("sample", len(found) / n)
        return tuple(found[k] for k in random.permutation(n)) if rivals else tuple(found)

    def _shares(self, fits: Sequence[Fit], weights: ArrayLike | None) -> Array:
        """Return probabilities of fits that add up to 1."""
        shares = np.ones(len(fits)) if weights is None else np.asarray(weights, dtype=float)
        if shares.shape != (len(fits),) or not (np.all(shares >= 0.0) and shares.sum() > 0.0):
            raise IdentificationError(
                f"weights are {shares.tolist()}; expected {len(fits)} numbers from 0, one for each "
                "fit"
            )
        other = [fit.model.robot for fit in fits if fit.model.n != self.model.n]
        if other:
            raise IdentificationError(
                f"rival of robot {other[0].name!r} with {other[0].n} joints; expected fits of "
                f"{self.model.robot.name!r}"
            )
        return np.asarray(shares / shares.sum())

    def _draws(self, n: int, *, seed: int) -> Iterator[Fit]:
        from lieid_casadi.identification.uncertainty.posterior import Posterior

        if not self.physically_consistent:
            raise IdentificationError(
                f"masses and inertias of a fit of method {self.method} are not physically "
                "consistent; samples need a fit of method feasible: lieid identify … --method "
                "feasible"
            )
        posterior = Posterior(
            self.compiled, self.values, self.shapes, self.covariance, self.parameters
        )
        for parameters, shapes in posterior.draws(n, seed=seed):
            yield replace(
                self,
                values=self.model.base.combination @ parameters,
                shapes=shapes,
                parameters=parameters,
                certificate=posterior.certificate(parameters, self.certificate),
            )

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
        with atomic_binary(path) as file:
            file.write(content_of(self))

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
        return cls(**read_fields(path))

    def parameter_table(self) -> list[dict[str, Any]]:
        """Return one row per fitted number: name, joint (from 1), value, std, unit.

        ``source`` is the joint (from 1) whose motion acts, of a coupling; ``relative_std`` is
        std/|value|. Both are None otherwise, the latter where it is not finite.
        """
        numbers = np.concatenate([self.values, self.shapes])
        expressions = [self.model.base.expression(k) for k in range(len(self.values))]
        expressions += [shape.label for shape in self.model.shapes]
        return [
            {
                "name": parameter.name,
                "joint": parameter.joint + 1,
                "source": None if parameter.source is None else parameter.source + 1,
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

    def plot(self, ax: Axes | None = None) -> Figure:
        """Draw each parameter relative to its standard deviation; the figure is not shown."""
        numbers = np.concatenate([self.values, self.shapes])
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            sizes = np.nan_to_num(np.abs(numbers) / self.std, nan=0.0, posinf=0.0)
        return plot_sizes([p.label for p in self.fitted], sizes, ax)

    def _repr_html_(self) -> str:
        return html(parameter_table(self))

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


def predict(fit: Fit, recording: Recording) -> Array:
    """Return the torque (N, n) of a fit at the recording's own times, N·m; see `Fit.predict`."""
    return fit.predict(recording)


def content_of(fit: Fit) -> bytes:
    """Return the content of the file that `Fit.save` writes."""
    own = {field.name: getattr(fit, field.name) for field in fields(fit)}
    return file_content(own, names=[p.label for p in fit.fitted], std=fit.std)


def parameter_table(fit: Fit) -> Table:
    """Return the fitted parameters with their standard deviations."""
    rows = [
        (
            row["expression"],
            row["value"],
            row["std"],
            100.0 * row["relative_std"] if row["relative_std"] else None,
            row["unit"],
        )
        for row in fit.parameter_table()
    ]
    shapes = f" and {len(fit.shapes)} shape parameters" if len(fit.shapes) else ""
    title = (
        f"{fit.model.robot.name}: {fit.model.base.count} base parameters{shapes}, method "
        f"{fit.method}, effects {', '.join(fit.model.effects) or 'none'}"
    )
    return make_table(title, ("parameter", "value", "std", "std %", "unit"), rows)


def plot_sizes(labels: Sequence[str], sizes: Array, ax: Axes | None = None) -> Figure:
    """Draw the |value| of parameters in standard deviations, largest first; return the figure."""
    order = np.argsort(-sizes)
    figure, ax = drawing(ax, 7.0, 0.18 * len(order) + 1.2)
    places = np.arange(len(order))
    ax.barh(places, sizes[order], color="tab:blue")
    ax.axvline(3.0, color="0.4", linewidth=1.0, linestyle="--")
    # names of a user's effects are not mathematical expressions
    ax.set_yticks(places, [labels[k].replace("$", r"\$") for k in order], fontsize=6)
    ax.set_xscale("symlog", linthresh=1.0)
    ax.invert_yaxis()
    ax.set_xlabel("|value| / standard deviation (dashed: 3)")
    return figure
