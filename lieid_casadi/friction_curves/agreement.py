"""Whether two determinations of one joint's friction say the same."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.stats import chi2

from lieid_casadi.errors import ModelError
from lieid_casadi.friction_curves.constant_speed import steady_columns
from lieid_casadi.friction_curves.curve import FrictionCurve
from lieid_casadi.friction_curves.friction_fit import FrictionFit
from lieid_casadi.identification.fit import Fit
from lieid_casadi.identification.regression.shape_range import ShapeRange

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Array = NDArray[np.float64]
STEP = 1e-5  # of a shape's range
RANK = 1e-8  # of the largest variance: directions below are rounding
SIGNIFICANT = 0.01
NEGLIGIBLE = 0.05  # of the friction: smaller differences never count as disagreement


@dataclass(frozen=True, eq=False)
class FrictionAgreement:
    """Friction of one joint by two determinations, over speed and load.

    Attributes
    ----------
    joint : int
        From 0.
    speed, load : (G,)
        rad/s, N·m.
    first, second : (G,)
        Friction, N·m.
    std : (G,)
        Of first − second.
    relative : float
        RMS of the difference over the RMS of the friction.
    p_value : float
        Null hypothesis: the two differ by their uncertainties only.
    """

    joint: int
    speed: Array
    load: Array
    first: Array
    second: Array
    std: Array
    relative: float
    p_value: float

    @property
    def agree(self) -> bool:
        """Whether the difference is within the uncertainties, or below 5 % of the friction."""
        return self.p_value >= SIGNIFICANT or self.relative <= NEGLIGIBLE

    @property
    def worst(self) -> int:
        """Index of the point with the largest difference, in N·m."""
        return int(np.argmax(np.abs(self.first - self.second)))

    def __str__(self) -> str:
        k, verdict = self.worst, "agree" if self.agree else "disagree"
        return (
            f"joint {self.joint + 1}: the two {verdict}: they differ by {self.relative:.1%} of the "
            f"friction (p = {self.p_value:.2g} by their uncertainties), most at "
            f"{self.speed[k]:.3g} rad/s under {self.load[k]:.3g} N·m: {self.first[k]:.4g} and "
            f"{self.second[k]:.4g}, standard deviation of the difference {self.std[k]:.2g} N·m"
        )

    def to_dict(self) -> dict[str, Any]:
        """Return everything for JSON; joints from 1."""
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
        """Draw both over speed; return the figure."""
        from lieid_casadi.friction_curves.plots import plot_agreement

        return plot_agreement(self, ax)


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

    Compared is half the difference at ±speed and equal load, which has no offset: a friction
    curve, a model fitted to one, or the friction in a fit of the whole arm.

    Parameters
    ----------
    first, second : FrictionCurve, FrictionFit or Fit
    joint : int, optional
        From 0; that of a curve if left out.
    speed, load : (G,), optional
        rad/s and N·m; the points of a curve if left out.

    Raises
    ------
    ModelError
        Two joints, or no curve and no speeds.
    """
    curves = [c for c in (_curve(first), _curve(second)) if c is not None]
    joints = {c.joint for c in curves} | ({joint} if joint is not None else set())
    if len(joints) != 1:
        raise ModelError(
            "friction of which joint? state joint="
            if not joints
            else f"friction of joints {', '.join(str(j + 1) for j in sorted(joints))}; expected one"
        )
    (j,) = joints
    if speed is None:
        if not curves:
            raise ModelError("at which speeds? state speed= (rad/s) and load= (N·m)")
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

    def at(values: Array) -> Array:
        return steady_columns(compiled, joint, speed, values, load=load)

    columns = at(shapes)
    steps = STEP * ShapeRange.of(source.model.shapes).slope(shapes)
    slopes = [
        (at(shapes + step * unit) - columns) @ coefficients / step
        for step, unit in zip(steps, np.eye(len(shapes)), strict=True)
    ]
    jacobian = np.column_stack([columns, *slopes])
    used = np.abs(jacobian).max(axis=0, initial=0.0) > 0.0
    reach = jacobian[:, used]
    return columns @ coefficients, reach @ covariance[np.ix_(used, used)] @ reach.T


def _of_effects(fit: Fit) -> Array:
    """Return the covariance of effect coefficients and shapes (m + s, m + s)."""
    n, count, shapes = fit.model.n, len(fit.model.columns), len(fit.shapes)
    kept = fit.model.base.kept
    place = np.full(count + shapes, -1)
    place[kept[kept >= 10 * n] - 10 * n] = np.flatnonzero(kept >= 10 * n)
    place[count:] = len(kept) + np.arange(shapes)
    known = np.flatnonzero(place >= 0)
    covariance = np.zeros((len(place), len(place)))
    covariance[np.ix_(known, known)] = fit.covariance[np.ix_(place[known], place[known])]
    return covariance


def _p_value(difference: Array, covariance: Array) -> float:
    """Return the probability of a larger difference by chance."""
    if not np.all(np.isfinite(covariance)):
        return 1.0
    variances, directions = np.linalg.eigh(covariance)
    seen = variances > RANK * max(float(variances[-1]), 0.0)
    if not seen.any():
        return 1.0 if np.allclose(difference, 0.0) else 0.0
    scores = (directions[:, seen].T @ difference) ** 2 / variances[seen]
    return float(chi2.sf(scores.sum(), int(seen.sum())))
