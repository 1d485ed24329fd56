"""Physically consistent parameters from the result of weighted least squares."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from lieid_casadi.arrays import Array
from lieid_casadi.errors import (
    ConvergenceWarning,
    LieidWarning,
    NoSolution,
    NotDissipativeWarning,
    StatedMassWarning,
)
from lieid_casadi.identification.feasible.certificate import (
    Certificate,
    least_dissipation,
    least_mass_matrix_eigenvalue,
    position_range,
    pseudo_inertia_eigenvalues,
)
from lieid_casadi.identification.feasible.dissipation import dissipation_rows, largest_speed
from lieid_casadi.identification.feasible.problem import (
    ConvexSolver,
    FeasibleProblem,
    reference_bodies,
)
from lieid_casadi.identification.regression.cross_validation import Fold, cross_validated_rms
from lieid_casadi.identification.regression.design_matrix import Design, varying_columns
from lieid_casadi.identification.regression.fixed_point import DelaySteps, FitState, has_settled
from lieid_casadi.identification.regression.least_squares import Factor, stacked
from lieid_casadi.identification.regression.priors import with_priors
from lieid_casadi.recording import Processed
from lieid_casadi.robot import Robot

DRIVING = 0.1  # of a joint's noise: a warning is given if friction drives the joint by more


def driving(design: Design, start: FitState, problem: FeasibleProblem) -> list[LieidWarning]:
    """Return warnings about joints that least-squares friction would drive at a permitted speed."""
    columns = design.model.columns
    friction = start.parameters[10 * problem.n :]
    recorded = np.max([np.abs(s.dq).max(axis=0) for s in design.segments], axis=0)
    permitted = largest_speed(design.model, design.segments)
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
                    "error of this joint: add the missing friction effect"
                )
            )
    return found


WEIGHTS = tuple(10.0**k for k in range(-5, 2))  # values of λ tried by cross-validation
ROUNDS = 10  # largest number of iterations over the load
POSES = 10_000  # at which the mass matrix is checked
MASS_FACTOR = 2.0  # between the total mass of a fit and that of the description: a warning beyond


@dataclass(frozen=True, eq=False)
class ConsistentFit:
    """Result of the method ``feasible``."""

    state: FitState  # at the physically consistent parameters
    problem: FeasibleProblem
    regularization: float  # λ
    source: str  # of λ: ``cross-validation`` or ``given``
    #: weighted factor of other rows to base values (p,), at the same λ
    estimate: Callable[[Factor], Array]
    warnings: tuple[LieidWarning, ...]


def make_feasible(
    design: Design,
    start: FitState,
    folds: Sequence[Fold],
    regularization: float | None,
    report: Callable[[str, float], None],
) -> ConsistentFit:
    """Return the best physically consistent parameters.

    Weights and shape parameters are those of ``start``; a regularization that is not given is
    chosen by cross-validation.
    """
    problem, found = feasible_problem(design, start)
    solver = ConvexSolver(problem)
    weight = regularization
    if weight is None:
        weight = choose_regularization(solver, folds, start.weighting.noise, report)
    state, settled = _follow_load(design, start, solver, weight)
    if not settled:
        found = (
            *found,
            ConvergenceWarning(
                f"the load had not converged after {ROUNDS} iterations of method feasible; "
                "use method wls, or remove load-dependent effects"
            ),
        )
    found = (*found, *driving(design, start, problem))
    estimate = partial(solver.base_values, weight=weight)
    source = "cross-validation" if regularization is None else "given"
    return ConsistentFit(state, problem, weight, source, estimate, found)


def certify(design: Design, consistent: ConsistentFit, rms: Array, rms_wls: Array) -> Certificate:
    """Check the result independently of the solver."""
    problem, parameters = consistent.problem, consistent.state.parameters
    links, robot = parameters[: 10 * problem.n], design.model.robot
    q = np.concatenate([segment.q[segment.kept] for segment in design.segments])

    def load(bodies: Array) -> Array:
        return np.asarray(np.sqrt(np.mean(design.compiled.gravity(q, bodies) ** 2, axis=0)))

    return Certificate(
        regularization=consistent.regularization,
        regularization_source=consistent.source,
        pseudo_inertia_eigenvalue=pseudo_inertia_eigenvalues(links),
        mass_matrix_eigenvalue=least_mass_matrix_eigenvalue(
            design.compiled, links, poses=POSES, seed=0
        ),
        poses=POSES,
        least_dissipation=least_dissipation(problem.friction, parameters[10 * problem.n :]),
        divergence=problem.divergences(parameters),
        rms=rms,
        rms_wls=rms_wls,
        gravity=load(links),
        stated_gravity=load(robot.link_parameters) if robot.has_inertia else None,
    )


def mass_warnings(robot: Robot, parameters: Array) -> list[LieidWarning]:
    """Return a warning if the masses of a fit are in sum far from those that the robot states."""
    if not robot.has_inertia:
        return []
    total, stated = (
        float(x[: 10 * robot.n : 10].sum()) for x in (parameters, robot.link_parameters)
    )
    if stated <= 0.0 or 1.0 / MASS_FACTOR <= total / stated <= MASS_FACTOR:
        return []
    return [
        StatedMassWarning(
            f"the links have {total:.3g} kg in this fit, and {stated:.3g} kg by the description of "
            f"{robot.name!r}: check the unit of the torque, and whether the controller compensates "
            "gravity (lieid check), or the stated masses"
        )
    ]


def feasible_problem(
    design: Design, start: FitState
) -> tuple[FeasibleProblem, tuple[LieidWarning, ...]]:
    """Return the convex problem of a model, and warnings about its nominal inertias."""
    model, factor = design.model, start.weighting.factor
    references, found = reference_bodies(model, factor)
    lower, upper = position_range(model.robot)
    friction = dissipation_rows(
        design.compiled,
        start.shapes,
        velocity=largest_speed(model, design.segments),
        load=_largest_load(design, start.parameters),
        temperature=_largest_temperature(design.segments),
        lower=lower,
        upper=upper,
    )
    return FeasibleProblem.of(model, references, friction, factor), found


def choose_regularization(
    solver: ConvexSolver,
    folds: Sequence[Fold],
    noise: Array,
    report: Callable[[str, float], None] | None = None,
) -> float:
    """Return the λ with the smallest held-out error in units of the joints' noise."""
    best, least, failure = None, np.inf, None
    for k, weight in enumerate(WEIGHTS):
        if report is not None:
            report("regularization", k / len(WEIGHTS))
        try:
            rms = cross_validated_rms(folds, partial(solver.base_values, weight=weight))
        except NoSolution as error:  # small λ on little data; a larger one may converge
            failure = error
            continue
        score = float(np.nansum((rms / noise) ** 2))
        if score < least:
            best, least = weight, score
    if best is None:
        assert failure is not None
        raise failure
    return best


def _follow_load(
    design: Design, start: FitState, solver: ConvexSolver, weight: float
) -> tuple[FitState, bool]:
    """Solve repeatedly with the load of the preceding solution until the torque converges."""
    model = design.model
    iterate = bool(varying_columns(model).any())
    rows, weighting = start.rows, start.weighting
    before, given, steps = None, None, DelaySteps(model)
    for _ in range(ROUNDS):
        parameters = solver.solve(weighting.factor, weight)
        values = model.base.combination @ parameters
        state = FitState(
            shapes=start.shapes,
            rows=rows,
            weighting=weighting,
            solution=replace(start.solution, values=values),
            parameters=parameters,
        )
        if not iterate:
            return state, True
        predicted = rows.predicted(values)
        if before is not None and has_settled(predicted, before):
            return state, True
        before, given = predicted, steps.next(given, parameters)
        rows = design.linearized(start.shapes, given)
        factor = with_priors(stacked(rows, start.weighting.rows), design)
        weighting = replace(start.weighting, factor=factor)
    return state, False


def _largest_load(design: Design, parameters: Array) -> Array:
    links = parameters[: 10 * design.model.n]
    loads = [
        np.abs(design.compiled.inverse_dynamics(s.q, s.dq, s.ddq, links)).max(axis=0)
        for s in design.segments
    ]
    return np.asarray(np.max(loads, axis=0))


def _largest_temperature(segments: Sequence[Processed]) -> Array:
    largest = [np.abs(s.temperature).max(axis=0) for s in segments if s.temperature is not None]
    return np.asarray(np.max(largest, axis=0)) if largest else np.zeros(segments[0].n)
