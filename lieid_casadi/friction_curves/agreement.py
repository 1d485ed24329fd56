"""Comparison of two determinations of the friction of one joint."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike
from scipy.stats import chi2

from lieid_casadi.arrays import Array
from lieid_casadi.errors import ModelError
from lieid_casadi.friction_curves.curve import FrictionCurve
from lieid_casadi.friction_curves.friction_fit import FrictionFit, steady_columns
from lieid_casadi.identification.fit import Fit
from lieid_casadi.identification.regression.variable_projection import ShapeRange

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

STEP = 1e-5  # finite difference relative to the range of a shape
RANK = 1e-8  # variance relative to the largest below which a direction is rounding
SIGNIFICANT = 0.01  # p-value below which the difference exceeds the uncertainties
NEGLIGIBLE = 0.05  # difference relative to the friction that is described as small
SMALLEST_P = 1e-6  # smaller p-values are printed as below it


@dataclass(frozen=True, eq=False)
class FrictionAgreement:
    """Difference between two determinations of the friction of one joint."""

    joint: int  # from 0
    speed: Array  # (G,) Points of the comparison, rad/s and N·m
    load: Array  # (G,) Points of the comparison, rad/s and N·m
    first: Array  # (G,) Friction by the two determinations, N·m
    second: Array  # (G,) Friction by the two determinations, N·m
    std: Array  # (G,) Standard deviation of first − second, N·m
    relative: float  # RMS of the difference divided by the RMS of the friction
    #: of a chi-square test; null hypothesis: the difference is due to the uncertainties
    p_value: float

    @property
    def agree(self) -> bool:
        """Whether the difference is within the uncertainties."""
        return self.p_value >= SIGNIFICANT

    @property
    def worst(self) -> int:
        """Index of the point with the largest difference, in N·m."""
        return int(np.argmax(np.abs(self.first - self.second)))

    def __str__(self) -> str:
        k = self.worst
        return (
            f"joint {self.joint + 1}: {self.verdict}; the difference is "
            f"{100.0 * self.relative:.1f} % of the friction ({self._p_text}), largest at "
            f"{self.speed[k]:.3g} rad/s and {self.load[k]:.3g} N·m load: {self.first[k]:.4g} and "
            f"{self.second[k]:.4g} N·m, "
            f"standard deviation of the difference {self.std[k]:.2g} N·m"
        )

    @property
    def verdict(self) -> str:
        """The result in words: equal within the uncertainties, or different, and how much."""
        if self.p_value >= SIGNIFICANT:
            return "the two determinations agree within their uncertainties"
        if self.relative <= NEGLIGIBLE:
            return (
                "the two determinations differ by more than their uncertainties, but by less than "
                f"{100.0 * NEGLIGIBLE:.0f} % of the friction"
            )
        return "the two determinations disagree"

    @property
    def _p_text(self) -> str:
        below = self.p_value < SMALLEST_P
        return f"p < {SMALLEST_P:.0e}" if below else f"p = {self.p_value:.2g}"

    def to_dict(self) -> dict[str, Any]:
        """Return all attributes for JSON; joints count from 1."""
        return {
            "joint": self.joint + 1,
            "agree": self.agree,
            "relative": self.relative,
            "p_value": self.p_value,
            "speed": self.speed.tolist(),
            "load": self.load.tolist(),
            "first": self.first.tolist(),
            "second": self.second.tolist(),
            "std": self.std.tolist(),
        }

    def plot(self, ax: Axes | None = None) -> Figure:
        """Draw both determinations over speed and return the figure."""
        from lieid_casadi.friction_curves.plots import plot_agreement

        verdict = (
            f"{'agree' if self.agree else 'disagree'}, differ by {100.0 * self.relative:.1f} %"
        )
        title = f"joint {self.joint + 1}: {verdict}"
        return plot_agreement(self.speed, self.first, self.second, self.std, title, ax)


Determination = FrictionCurve | FrictionFit | Fit


def compare_friction(
    first: Determination,
    second: Determination,
    *,
    joint: int | None = None,
    speed: ArrayLike | None = None,
    load: ArrayLike | None = None,
) -> FrictionAgreement:
    """Compare the friction of one joint by two determinations.

    The compared quantity is half the difference of the friction torque at ±speed and equal
    load, which does not contain the offset.

    ``first``, ``second``: a friction curve, a model fitted to one, or a fit of the whole arm;
    ``joint``: from 0; by default that of the curve; ``speed``, ``load`` (G,): points of the
    comparison, rad/s and N·m; by default those of the curve.
    Raises `ModelError`: the joints differ, or neither a curve nor speeds are given.
    """
    curves = [c for c in (_curve(first), _curve(second)) if c is not None]
    joints = {c.joint for c in curves} | ({joint} if joint is not None else set())
    if len(joints) != 1:
        raise ModelError(
            "no joint given; state joint="
            if not joints
            else f"friction of joints {', '.join(str(j + 1) for j in sorted(joints))}; expected one"
        )
    (j,) = joints
    if speed is None:
        if not curves:
            raise ModelError("no speeds given; state speed= (rad/s) and load= (N·m)")
        speeds, loads = curves[0].speed, curves[0].load
    else:
        speeds = np.atleast_1d(np.asarray(speed, dtype=float))
        loads = np.broadcast_to(
            np.asarray(0.0 if load is None else load, dtype=float), speeds.shape
        )
    a, covariance_a = _friction(first, j, speeds, loads)
    b, covariance_b = _friction(second, j, speeds, loads)
    difference, covariance = a - b, covariance_a + covariance_b
    size = float(np.sqrt(np.mean((0.5 * (a + b)) ** 2)))
    return FrictionAgreement(
        joint=j,
        speed=speeds,
        load=np.asarray(loads),
        first=a,
        second=b,
        std=np.sqrt(np.diag(covariance)),
        relative=float(np.sqrt(np.mean(difference**2))) / max(size, 1e-300),
        p_value=_p_value(difference, covariance),
    )


def _curve(source: Determination) -> FrictionCurve | None:
    if isinstance(source, FrictionFit):
        return source.curve
    return source if isinstance(source, FrictionCurve) else None


def _friction(source: Determination, joint: int, speed: Array, load: Array) -> tuple[Array, Array]:
    """Return friction (G,) and its covariance (G, G)."""
    if isinstance(source, FrictionCurve):
        if not (np.array_equal(speed, source.speed) and np.array_equal(load, source.load)):
            raise ModelError("a friction curve has values at its own points only")
        return source.friction, np.diag(source.std**2)
    if isinstance(source, FrictionFit):
        coefficients, covariance = source.coefficients, source.covariance
    else:
        coefficients, covariance = source.effect_coefficients, _of_effects(source)
    shapes, compiled = source.shapes, source.compiled

    def columns_at(values: Array) -> Array:
        return steady_columns(compiled, joint, speed, values, load=load)

    columns = columns_at(shapes)
    steps = STEP * ShapeRange.of(source.model.shapes).slope(shapes)
    slopes = [
        (columns_at(shapes + step * unit) - columns) @ coefficients / step
        for step, unit in zip(steps, np.eye(len(shapes)), strict=True)
    ]
    jacobian = np.column_stack([columns, *slopes])
    used = np.abs(jacobian).max(axis=0, initial=0.0) > 0.0
    jacobian = jacobian[:, used]
    return columns @ coefficients, jacobian @ covariance[np.ix_(used, used)] @ jacobian.T


def _of_effects(fit: Fit) -> Array:
    """Return the covariance (m + s, m + s) of effect coefficients and shapes."""
    n, count, shapes = fit.model.n, len(fit.model.columns), len(fit.shapes)
    kept = fit.model.base.kept
    place = np.full(count + shapes, -1)
    place[kept[kept >= 10 * n] - 10 * n] = np.flatnonzero(kept >= 10 * n)
    place[count:] = len(kept) + np.arange(shapes)
    fitted = np.flatnonzero(place >= 0)
    covariance = np.zeros((len(place), len(place)))
    covariance[np.ix_(fitted, fitted)] = fit.covariance[np.ix_(place[fitted], place[fitted])]
    return covariance


def _p_value(difference: Array, covariance: Array) -> float:
    """Return the p-value of a chi-square test of the difference (G,)."""
    if not np.all(np.isfinite(covariance)):
        return 1.0
    variances, directions = np.linalg.eigh(covariance)
    visible = variances > RANK * max(float(variances[-1]), 0.0)
    if not visible.any():
        return 1.0 if np.allclose(difference, 0.0) else 0.0
    scores = (directions[:, visible].T @ difference) ** 2 / variances[visible]
    return float(chi2.sf(scores.sum(), int(visible.sum())))
