"""From the arguments of ``excite`` to the specification of a design, checked."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lieid_casadi.errors import ExcitationError
from lieid_casadi.excitation.basis import families
from lieid_casadi.excitation.criteria.column_scaling import ScalingName, column_scale
from lieid_casadi.excitation.criteria.criterion import (
    NAMES,
    CriterionExpression,
    CriterionName,
    criterion_name,
)
from lieid_casadi.excitation.criteria.design_model import design_model
from lieid_casadi.excitation.design_problem import ExcitationDesign
from lieid_casadi.excitation.fitted_arm import IdentifiedModel, model_and_fit
from lieid_casadi.excitation.limits.default_limits import MARGIN, default_limits
from lieid_casadi.excitation.limits.joint_limits import (
    check_duration,
    check_start_pose,
    motion_range,
)
from lieid_casadi.excitation.limits.symbolic_limits import Limit
from lieid_casadi.excitation.solvers.warm_start import load_positions
from lieid_casadi.model import Model
from lieid_casadi.robot import Robot

Array = NDArray[np.float64]
MOST_SAMPLES = 100_000  # of one period in the criterion


def make_design(
    source: Model | Robot | IdentifiedModel,
    *,
    basis: families.Basis,
    criterion: CriterionName | CriterionExpression = "combined",
    inertial_only: bool = False,
    limits: Sequence[Limit] | None = None,
    start_pose: ArrayLike | None = None,
    free_start: bool = False,
    acceleration: ArrayLike | None = None,
    margin: float = MARGIN,
    samples: int = 100,
    scaling: ScalingName | Sequence[float] | Array = "si",
    condition_threshold: float | None = None,
    neg_log_det_threshold: float | None = None,
    start: str | Path | None = None,
) -> ExcitationDesign:
    """Check the arguments of `excite` and return the design that they specify.

    Parameters
    ----------
    source : Model, Robot or Fit
    basis : Basis
    criterion, inertial_only, limits, start_pose, free_start, acceleration, samples, scaling, start
        As in `excite`.
    condition_threshold, neg_log_det_threshold : float, optional
        Δ₁ and Δ₂ of the criterion ``combined``.

    Raises
    ------
    ExcitationError
    """
    if not callable(criterion) and criterion not in NAMES:
        raise ExcitationError(
            f"criterion: {criterion!r}; expected one of {', '.join(NAMES)}, or a function of the "
            "information matrix"
        )
    families.check_basis(basis)
    if not 4 * basis.size <= samples <= MOST_SAMPLES:
        raise ExcitationError(
            f"samples: {samples}; expected {4 * basis.size} at least for {basis.size} "
            f"coefficients per joint, and at most {MOST_SAMPLES}"
        )
    check_thresholds(criterion, condition_threshold, neg_log_det_threshold)
    model, fit = model_and_fit(source)
    reduced = Model(model.robot) if inertial_only else design_model(model)[0]
    robot = reduced.robot
    joints = motion_range(robot, acceleration, margin=margin)
    check_duration(robot, joints, basis.duration)
    first = None if start is None else load_positions(start, robot.n)
    if start_pose is None and first is not None:
        start_pose = first[0]
    pose = None if start_pose is None else np.asarray(start_pose, dtype=float)
    if pose is not None:
        check_start_pose(robot, joints, pose)
    if limits is None:
        limits = default_limits(robot, margin=margin)
    return ExcitationDesign(
        reduced, fit, basis, samples, joints, tuple(limits), pose, not free_start, criterion,
        column_scale(reduced, scaling), condition_threshold, neg_log_det_threshold, first,
    )  # fmt: skip


def check_thresholds(
    criterion: CriterionName | CriterionExpression,
    condition_threshold: float | None,
    neg_log_det_threshold: float | None,
) -> None:
    """Refuse thresholds that the criterion does not have.

    Parameters
    ----------
    criterion : str or callable
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
                f"{name}: only the criterion 'combined' has it, not {criterion_name(criterion)!r}"
            )
    if condition_threshold is not None and not condition_threshold >= 1.0:
        raise ExcitationError(f"condition_threshold: {condition_threshold:g}; expected at least 1")
