"""Physically consistent draws from the posterior of a fit, for ensembles and domain randomisation.

Base and shape parameters are drawn from the normal distribution with the fit's covariance. A draw
whose nearest link parameters have positive definite pseudo-inertias, and whose friction dissipates
and lies within its bounds, is used as it is; any other is replaced by the consistent parameters
nearest to it in units of the covariance.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from lieid_casadi.arrays import Array
from lieid_casadi.effects import ArmEffect
from lieid_casadi.errors import IdentificationError, NoSolution
from lieid_casadi.identification.feasible.certificate import (
    Certificate,
    least_dissipation,
    least_mass_matrix_eigenvalue,
    position_range,
    pseudo_inertia_eigenvalues,
)
from lieid_casadi.identification.feasible.convex_solver import ConvexSolver
from lieid_casadi.identification.feasible.dissipation import dissipation_rows
from lieid_casadi.identification.feasible.problem import FeasibleOptions, FeasibleProblem
from lieid_casadi.identification.regression.least_squares import Factor
from lieid_casadi.robot.inertia import pseudo_inertia

if TYPE_CHECKING:
    from lieid_casadi.identification.fit import Fit

WEIGHT = 1e-3  # of the divergence from the fit's bodies, in squared standard deviations
KNOWN = 1e-12  # variance relative to the largest (scaled) below which a direction is known exactly
UNKNOWN_SPEED = 2.0  # rad/s, velocity limit of a robot that states none
ATTEMPTS = 20  # draws for one sample, if the solver finds no consistent parameters


def sample_fits(
    fit: Fit,
    count: int,
    *,
    seed: int = 0,
    progress: Callable[[str, float], None] | None = None,
) -> tuple[Fit, ...]:
    """Return physically consistent fits drawn from the posterior; see `Fit.sample`."""
    if count < 1:
        raise IdentificationError(f"got {count} samples; expected at least 1")
    if not fit.physically_consistent:
        raise IdentificationError(
            f"masses and inertias of a fit of method {fit.method} are not physically consistent; "
            "samples need a fit of method feasible: lieid identify … --method feasible"
        )
    random, p = np.random.default_rng(seed), len(fit.values)
    rows, root = _whitened(fit.covariance)
    mean = np.concatenate([fit.values, fit.shapes])
    lower, upper = (
        np.array([getattr(s, end) for s in fit.model.shapes]) for end in ("lower", "upper")
    )
    solver = ConvexSolver(_problem(fit, rows[:, :p]))
    found: list[Fit] = []
    failures = 0
    while len(found) < count:
        drawn = mean + root @ random.standard_normal(root.shape[1])
        shapes = np.clip(drawn[p:], lower, upper)
        parameters = fit.model.base.lift(drawn[:p], fit.parameters)
        if not _consistent(solver.problem, parameters):
            target = np.zeros((p + 1, p + 1))
            small = rows[:, :p]
            _, r = np.linalg.qr(np.column_stack([small, small @ drawn[:p]]))
            target[: len(r)] = r
            try:
                parameters = solver.solve(Factor(target, 1), WEIGHT)
            except NoSolution:
                failures += 1
                if failures > ATTEMPTS * count:
                    raise
                continue
        values = fit.model.base.combination @ parameters
        sample = replace(fit, values=values, shapes=shapes, parameters=parameters)
        found.append(replace(sample, certificate=_certificate(sample, solver.problem)))
        if progress is not None:
            progress("sample", len(found) / count)
    return tuple(found)


def _certificate(sample: Fit, problem: FeasibleProblem) -> Certificate | None:
    """Return the certificate of the fit that was sampled, checked for the sample."""
    if sample.certificate is None:
        return None
    links, coefficients = sample.link_parameters, sample.effect_coefficients
    return replace(
        sample.certificate,
        pseudo_inertia_eigenvalue=pseudo_inertia_eigenvalues(links),
        mass_matrix_eigenvalue=least_mass_matrix_eigenvalue(
            sample.compiled, links, poses=sample.certificate.poses, seed=0
        ),
        least_dissipation=least_dissipation(problem.friction, coefficients),
    )


def _whitened(covariance: Array) -> tuple[Array, Array]:
    """Return W (k, p + s) and L (p + s, k): |W·δ|² is δ in standard deviations, C = L·Lᵀ."""
    size = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    unit = np.where(size > 0.0, size, 1.0)
    variance, axes = np.linalg.eigh(covariance / np.outer(unit, unit))
    floor = KNOWN * max(float(variance[-1]), KNOWN)
    spread = np.sqrt(np.maximum(variance, floor))
    return (axes / spread).T / unit, unit[:, None] * axes * np.sqrt(np.maximum(variance, 0.0))


def _problem(fit: Fit, rows: Array) -> FeasibleProblem:
    """Return the constraints of consistent parameters, with the fit's bodies as references."""
    model, robot = fit.model, fit.model.robot
    lower, upper = position_range(robot)
    limit = robot.limit("velocity")
    poses = np.random.default_rng(0).uniform(lower, upper, (200, model.n))
    load = np.abs(fit.compiled.gravity(poses, fit.link_parameters)).max(axis=0)
    joint_effects = not any(isinstance(p.effect, ArmEffect) for p in model.placements)
    friction = np.zeros((0, len(model.columns)))
    if joint_effects:
        friction = dissipation_rows(
            fit.compiled,
            fit.shapes,
            velocity=np.where(np.isfinite(limit), limit, UNKNOWN_SPEED),
            load=load,
            temperature=np.zeros(model.n),
            lower=lower,
            upper=upper,
        )
    p = len(fit.values)
    target = np.zeros((p + 1, p + 1))
    _, r = np.linalg.qr(np.column_stack([rows, rows @ fit.values]))
    target[: len(r)] = r
    return FeasibleProblem(
        combination=model.base.combination,
        references=np.array([pseudo_inertia(b) for b in fit.link_parameters.reshape(-1, 10)]),
        lower=np.array([c.lower for c in model.columns]),
        upper=np.array([c.upper for c in model.columns]),
        friction=friction,
        typical=Factor(target, 1),
        options=FeasibleOptions(),
    )


def _consistent(problem: FeasibleProblem, parameters: Array) -> bool:
    """Whether parameters satisfy all constraints of the problem."""
    links, coefficients = parameters[: 10 * problem.n], parameters[10 * problem.n :]
    bodies = [np.linalg.eigvalsh(pseudo_inertia(b))[0] for b in links.reshape(-1, 10)]
    return bool(
        min(bodies) > 0.0
        and np.all((coefficients >= problem.lower) & (coefficients <= problem.upper))
        and np.all(problem.friction @ coefficients >= 0.0)
    )
