"""Warnings of the method ``feasible``: active bounds, and friction that was not dissipative."""

from __future__ import annotations

import numpy as np

from lieid_casadi.errors import BoundWarning, LieidWarning, NotDissipativeWarning
from lieid_casadi.identification.feasible.dissipation import largest_speed
from lieid_casadi.identification.feasible.problem import FeasibleProblem
from lieid_casadi.identification.regression.design_matrix import Design
from lieid_casadi.identification.regression.fixed_point import FitState

DRIVING = 0.1  # of a joint's noise: a warning is given if friction drives the joint by more


def at_bounds(design: Design, start: FitState, state: FitState) -> list[LieidWarning]:
    """Return warnings about coefficients that a bound keeps from the least-squares value.

    Parameters
    ----------
    design : Design
    start : FitState
        By weighted least squares.
    state : FitState
        At the physically consistent parameters.
    """
    found: list[LieidWarning] = []
    before, after = start.solution.values, state.solution.values
    for parameter, free, held in zip(design.model.base_columns, before, after, strict=True):
        if not parameter.lower <= free <= parameter.upper:
            found.append(
                BoundWarning(
                    f"{parameter.label} = {held:.3g} {parameter.unit} is limited by its bound "
                    f"[{parameter.lower:g}, {parameter.upper:g}]; least squares gives {free:.3g}: "
                    "another effect is missing from the model, or this effect is not present"
                )
            )
    return found


def driving(design: Design, start: FitState, problem: FeasibleProblem) -> list[LieidWarning]:
    """Return warnings about joints that least-squares friction would drive at a permitted speed.

    Parameters
    ----------
    design : Design
    start : FitState
        By weighted least squares.
    problem : FeasibleProblem
    """
    columns = design.model.columns
    friction = start.parameters[10 * problem.n :]
    recorded = np.max([np.abs(s.dq).max(axis=0) for s in design.segments], axis=0)
    permitted = largest_speed(design.model, design.segments, problem.options.velocity)
    found: list[LieidWarning] = []
    for joint in range(problem.n):
        own = np.array([c.joint == joint for c in columns], dtype=bool)
        rows = problem.friction[np.any(problem.friction[:, own] != 0.0, axis=1)]
        if len(rows) and float((rows @ friction).min()) < -DRIVING * start.weighting.noise[joint]:
            found.append(
                NotDissipativeWarning(
                    f"joint {joint + 1}: friction by least squares would drive the joint at some "
                    f"speed up to {permitted[joint]:.3g} rad/s (recorded: up to "
                    f"{recorded[joint]:.3g}); it is constrained to dissipate, which increases the "
                    "error of this joint: add the missing friction effect, or state a lower speed"
                )
            )
    return found
