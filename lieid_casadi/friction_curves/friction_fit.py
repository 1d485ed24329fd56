"""Result: a friction model fitted to a friction curve."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from lieid_casadi.arrays import Array
from lieid_casadi.compiled import Compiled, compile
from lieid_casadi.errors import LieidWarning, warning_list
from lieid_casadi.friction_curves.constant_speed import steady_columns
from lieid_casadi.friction_curves.curve import FrictionCurve
from lieid_casadi.json_numbers import number_or_none
from lieid_casadi.model import Model, Parameter
from lieid_casadi.tables import html

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


@dataclass(frozen=True, eq=False)
class FrictionFit:
    """A friction model fitted to the curve of one joint.

    Attributes
    ----------
    curve : FrictionCurve
    model : Model
        The robot with the effects on that joint.
    coefficients : (m,)
        Linear coefficients, in the order of ``model.columns``.
    shapes : (s,)
        Shape parameters, in the order of ``model.shapes``.
    covariance : (m + s, m + s)
        Covariance of both; infinite variance where the curve does not determine a parameter.
    predicted : (G,)
        Friction torque of the model at the curve's points, N·m.
    warnings : tuple of LieidWarning
    """

    curve: FrictionCurve
    model: Model
    coefficients: Array
    shapes: Array
    covariance: Array
    predicted: Array
    warnings: tuple[LieidWarning, ...]

    @cached_property
    def compiled(self) -> Compiled:
        """The model's functions."""
        return compile(self.model)

    @property
    def effects(self) -> tuple[str, ...]:
        """Labels of the effects, without the joint."""
        return tuple(p.effect.label for p in self.model.placements)

    @property
    def rms(self) -> float:
        """RMS of measured − predicted friction over the points, N·m (section 6.4.2)."""
        return float(np.sqrt(np.mean((self.curve.friction - self.predicted) ** 2)))

    @property
    def correlation(self) -> float:
        """Correlation coefficient of measured and predicted friction (section 6.4.2)."""
        if np.ptp(self.curve.friction) == 0.0 or np.ptp(self.predicted) == 0.0:
            return float("nan")
        return float(np.corrcoef(self.curve.friction, self.predicted)[0, 1])

    @property
    def bic(self) -> float:
        """Bayesian information criterion up to a constant of the curve; smaller is better."""
        count = len(self.curve)
        weighted = (self.curve.friction - self.predicted) / self.curve.std
        square = float(np.mean(weighted**2))
        free = len(self.coefficients) + len(self.shapes)
        return float(count * np.log(max(square, 1e-300)) + free * np.log(count))

    @property
    def std(self) -> Array:
        """Standard deviations of coefficients and shapes (m + s,)."""
        return np.sqrt(np.diag(self.covariance))

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """Coefficients, then shapes."""
        return (*self.model.columns, *self.model.shapes)

    def friction(
        self,
        speed: ArrayLike,
        *,
        load: ArrayLike = 0.0,
        temperature: ArrayLike = 0.0,
        position: ArrayLike = 0.0,
    ) -> Array:
        """Return the friction torque at constant speeds.

        Parameters
        ----------
        speed : (P,)
            Positive speeds, rad/s.
        load : (P,) or float
            Load torque, N·m.
        temperature : (P,) or float
            °C relative to the mean of the recordings.
        position : (P,) or float
            Joint position, rad.

        Returns
        -------
        (P,)
            N·m.
        """
        columns = steady_columns(
            self.compiled,
            self.curve.joint,
            speed,
            self.shapes,
            load=load,
            temperature=temperature,
            position=position,
        )
        return np.asarray(columns @ self.coefficients)

    def parameter_table(self) -> list[dict[str, Any]]:
        """Return one row per parameter: name, joint (from 1), value, std, unit."""
        values = np.concatenate([self.coefficients, self.shapes])
        return [
            {
                "name": p.name,
                "joint": p.joint + 1,
                "value": float(value),
                "std": number_or_none(std),
                "unit": p.unit,
            }
            for p, value, std in zip(self.parameters, values, self.std, strict=True)
        ]

    def to_dict(self) -> dict[str, Any]:
        """Return effects, parameters and goodness of fit for JSON."""
        return {
            "joint": self.curve.joint + 1,
            "effects": list(self.effects),
            "parameters": self.parameter_table(),
            "rms": self.rms,
            "correlation": number_or_none(self.correlation),
            "bic": self.bic,
            "predicted": self.predicted.tolist(),
            "warnings": warning_list(self.warnings),
        }

    def plot(self, ax: Axes | None = None) -> Figure:
        """Draw the curve and the model at low and high load and return the figure."""
        from lieid_casadi.friction_curves.plots import plot_fit

        return plot_fit(self, ax)

    def _repr_html_(self) -> str:
        from lieid_casadi.friction_curves.result_tables import parameter_table

        return html(parameter_table(self))

    def __repr__(self) -> str:
        return (
            f"<FrictionFit of {self.curve.joint_name}: {', '.join(self.effects)}; "
            f"RMS error {self.rms:.3g} {self.curve.unit}>"
        )
