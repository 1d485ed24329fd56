"""A design problem: its specification, and the functions that evaluate it."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from lieid_casadi.excitation.basis.families import Basis
from lieid_casadi.excitation.basis.trajectory import Parametrization, SampledBasis, period_grid
from lieid_casadi.excitation.criteria.criterion import (
    Criterion,
    CriterionExpression,
    CriterionName,
    LogDet,
    unit_norm_gram,
)
from lieid_casadi.excitation.criteria.information_matrix import InformationMatrix
from lieid_casadi.excitation.criteria.objective_value import ObjectiveValue
from lieid_casadi.excitation.fitted_arm import FittedArm
from lieid_casadi.excitation.limits.constraint_sets import SampledConstraints
from lieid_casadi.excitation.limits.joint_limits import MotionRange
from lieid_casadi.excitation.limits.start_pose import check_at_rest, find_start_pose
from lieid_casadi.excitation.limits.symbolic_limits import Limit, sets_of
from lieid_casadi.model import Model

Array = NDArray[np.float64]
SIGN_WIDTH = 0.02  # width of the smooth sign, in parts of the velocity limit
MARGIN = 1e-3  # distance from a limit during the optimization, in parts of its scale
COARSE = 4  # grid points of the optimization per sample of the criterion
FINE = 20  # grid points of the verification per sample of the criterion
FAR = 0.3  # distance of −log det per parameter from Δ₂ above which its gradient is omitted


@dataclass(frozen=True, eq=False)
class ExcitationDesign:
    """Specification of a design; picklable, so that another process can solve it.

    Attributes
    ----------
    model : Model
        Its regressor is the one that the criterion evaluates.
    fit : FittedArm or None
        Identified parameters; without them the stated inertias and initial shapes are used.
    basis : Basis
    samples : int
        Of the criterion, over one period.
    range : MotionRange
        Joint limits.
    limits : tuple of Limit
        Limits besides the joint limits.
    pose : (n,) or None
        Start pose; where the trajectory may start anywhere (``fixed`` False), its middle. Rad.
        None: found within all limits.
    fixed : bool
        Whether the trajectory starts and ends at ``pose``.
    criterion : str or callable
        Name, or expression of G.
    column_scale : (P,) or None
        Factors of the full regressor's columns, ones for plain SI; None: columns of the base
        regressor, scaled to unit norm.
    condition_threshold, neg_log_det_threshold : float, optional
        Δ₁ and Δ₂ of the criterion ``combined`` (Eq. 20).
    start : (N, n), optional
        Positions over one period, equidistant in time, from which the first search starts; rad.
    """

    model: Model
    fit: FittedArm | None
    basis: Basis
    samples: int
    range: MotionRange
    limits: tuple[Limit, ...]
    pose: Array | None
    fixed: bool
    criterion: CriterionName | CriterionExpression
    column_scale: Array | None
    condition_threshold: float | None = None
    neg_log_det_threshold: float | None = None
    start: Array | None = None


class ExcitationProblem:
    """A design with the compiled functions that its solution needs."""

    def __init__(self, design: ExcitationDesign) -> None:
        self.design = design
        sets, self.left_out = sets_of(design.limits, design.model.robot, design.fit)
        self.sets = (design.range.constraint_set(), *sets)
        self.pose = self._start_pose()
        self.parametrization = Parametrization(
            design.basis, self.pose, design.fixed, design.range.units
        )
        self.information = InformationMatrix(
            design.model, sign_width=SIGN_WIDTH * design.range.velocity, fit=design.fit
        )

    def _start_pose(self) -> Array:
        if self.design.pose is None:
            return find_start_pose(self.design.range, self.sets)
        check_at_rest(self.design.pose, self.sets)
        return self.design.pose

    @cached_property
    def metric(self) -> Array:
        """L (p, p): LᵀGL has the nonzero eigenvalues of the full scaled regressor's Gram matrix.

        The identity for base columns of unit norm.
        """
        if self.design.column_scale is None:
            return np.eye(self.design.model.base.count)
        scaled = self.design.model.base.combination * self.design.column_scale
        return np.asarray(np.linalg.cholesky(scaled @ scaled.T))

    @cached_property
    def samples(self) -> SampledBasis:
        """Grid of the criterion."""
        times = period_grid(self.design.basis.duration, self.design.samples)
        return SampledBasis(self.parametrization, times)

    def constraints(self, factor: int, *, margin: float = MARGIN) -> SampledConstraints:
        """Return the constraint sets on a grid ``factor`` times finer, with the period's end."""
        duration = self.design.basis.duration
        times = np.append(period_grid(duration, factor * self.design.samples), duration)
        return SampledConstraints(
            self.sets, SampledBasis(self.parametrization, times), margin=margin
        )

    def gram(self, z: Array) -> Array:
        """Return G (p, p) of the base regressor at z."""
        return self.information.at(self.samples.motion(z)).gram()

    def condition_number(self, gram: Array) -> float:
        """Return the condition number of the scaled regressor with G (p, p)."""
        scaled = gram if self.design.column_scale is not None else unit_norm_gram(gram)
        return condition_number(scaled, self.metric)

    def objective(self, criterion: Criterion, ceiling: float | None = None) -> ExcitationObjective:
        """Return f(z) of a criterion, with −log det G / p ≤ ceiling where one is given."""
        return ExcitationObjective(self, criterion, ceiling)


@dataclass(frozen=True, eq=False)
class ExcitationObjective:
    """A criterion as a function of z."""

    problem: ExcitationProblem
    criterion: Criterion
    ceiling: float | None

    def __call__(self, z: Array) -> ObjectiveValue:
        """Return value, gradient and −log det above its ceiling at free variables (m,)."""
        p = self.problem
        stacked = p.information.at(p.samples.motion(z))
        gram = stacked.gram()

        def in_variables(slope: Array) -> Array:
            return p.samples.gradient(p.information.gradient(stacked, slope))

        value, slope = self.criterion.evaluate(gram)
        excess, slopes = np.zeros(0), np.zeros((0, len(z)))
        if self.ceiling is not None:
            volume, volume_slope = LogDet().evaluate(gram)
            excess, slopes = np.array([volume - self.ceiling]), np.zeros((1, len(z)))
            if excess[0] > -FAR:  # farther away no step reaches the ceiling
                slopes[0] = in_variables(volume_slope)
        return ObjectiveValue(value, in_variables(slope), gram, excess, slopes)


def condition_number(gram: Array, metric: Array) -> float:
    """Return σ₁/σ_r from G; for condition numbers below 1e6."""
    sizes = np.linalg.eigvalsh(metric.T @ gram @ metric)
    return float(np.sqrt(sizes[-1] / max(sizes[0], 1e-300)))
