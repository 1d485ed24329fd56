"""From the arguments of ``excite`` to the specification of a design, checked."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from lieid_casadi.errors import ExcitationError
from lieid_casadi.excitation.basis import families
from lieid_casadi.excitation.criteria.column_scaling import column_scale
from lieid_casadi.excitation.criteria.criterion import NAMES, CriterionName
from lieid_casadi.excitation.criteria.design_model import design_model
from lieid_casadi.excitation.design_problem import ExcitationDesign
from lieid_casadi.excitation.limits.default_limits import MARGIN, default_limits
from lieid_casadi.excitation.limits.joint_limits import (
    check_duration,
    check_start_pose,
    motion_range,
)
from lieid_casadi.excitation.limits.symbolic_limits import Limit
from lieid_casadi.excitation.solvers.staged_solve import SOLVERS
from lieid_casadi.model import Model

MOST_SAMPLES = 100_000  # of one period in the criterion


def make_design(
    model: Model,
    *,
    basis: families.Basis,
    criterion: CriterionName = "combined",
    inertial_only: bool = False,
    constraints: Sequence[Limit] | None = None,
    start_pose: ArrayLike | None = None,
    free_start: bool = False,
    acceleration: ArrayLike | None = None,
    margin: float = MARGIN,
    samples: int = 100,
    scaling: str | ArrayLike = "si",
    condition_threshold: float | None = None,
    neg_log_det_threshold: float | None = None,
    solver: str = "ipopt",
) -> ExcitationDesign:
    """Check the arguments of `excite` and return the design that they specify.

    Parameters
    ----------
    model : Model
    basis : Basis
        Family of trajectories with its coefficients.
    criterion, inertial_only, constraints, start_pose, free_start, acceleration, samples, scaling
        As in `excite`.
    condition_threshold, neg_log_det_threshold : float, optional
        Δ₁ and Δ₂ of the criterion ``combined``.
    solver : str
        ``ipopt`` or ``sqp``.

    Raises
    ------
    ExcitationError
    """
    if criterion not in NAMES:
        raise ExcitationError(f"criterion: {criterion!r}; expected one of {', '.join(NAMES)}")
    if solver not in SOLVERS:
        raise ExcitationError(f"solver: {solver!r}; expected one of {', '.join(SOLVERS)}")
    if not 4 * basis.size <= samples <= MOST_SAMPLES:
        raise ExcitationError(
            f"samples: {samples}; expected {4 * basis.size} at least for {basis.size} "
            f"coefficients per joint, and at most {MOST_SAMPLES}"
        )
    check_thresholds(criterion, condition_threshold, neg_log_det_threshold)
    reduced = Model(model.robot) if inertial_only else design_model(model)[0]
    robot = reduced.robot
    limits = motion_range(robot, acceleration, margin=margin)
    check_duration(robot, limits, basis.duration)
    pose = None if start_pose is None else np.asarray(start_pose, dtype=float)
    if pose is not None:
        check_start_pose(robot, limits, pose)
    if constraints is None:
        constraints = default_limits(robot, margin=margin)
    return ExcitationDesign(
        reduced, basis, samples, limits, tuple(constraints), pose, not free_start, criterion,
        column_scale(reduced, scaling), solver, condition_threshold, neg_log_det_threshold,
    )  # fmt: skip


def check_thresholds(
    criterion: str, condition_threshold: float | None, neg_log_det_threshold: float | None
) -> None:
    """Refuse thresholds that the criterion does not have.

    Parameters
    ----------
    criterion : str
    condition_threshold, neg_log_det_threshold : float or None
        Δ₁ and Δ₂.

    Raises
    ------
    ExcitationError
    """
    given = {
        "condition_threshold": condition_threshold, "neg_log_det_threshold": neg_log_det_threshold,
    }  # fmt: skip
    for name, value in given.items():
        if value is not None and criterion != "combined":
            raise ExcitationError(
                f"{name}: only the criterion 'combined' has it, not {criterion!r}"
            )
    if condition_threshold is not None and not condition_threshold >= 1.0:
        raise ExcitationError(f"condition_threshold: {condition_threshold:g}; expected at least 1")
