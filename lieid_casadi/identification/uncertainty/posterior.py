"""Physically consistent draws from the posterior of a fit, for ensembles and domain randomisation.

Base and shape parameters are drawn from the normal distribution with the fit's covariance. A draw
whose nearest link parameters have positive definite pseudo-inertias, and whose friction dissipates
and lies within its bounds, is used as it is; any other is replaced by the consistent parameters
nearest to it in units of the covariance.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from lieid_casadi.arrays import Array
from lieid_casadi.compiled import Compiled
from lieid_casadi.effects import ArmEffect
from lieid_casadi.errors import NoSolution
from lieid_casadi.identification.feasible.certificate import (
    Certificate,
    least_dissipation,
    least_mass_matrix_eigenvalue,
    position_range,
    pseudo_inertia_eigenvalues,
)
from lieid_casadi.identification.feasible.dissipation import dissipation_rows
from lieid_casadi.identification.feasible.problem import ConvexSolver, FeasibleProblem
from lieid_casadi.identification.regression.least_squares import Factor
from lieid_casadi.identification.uncertainty.covariance import prior_rows, square_root
from lieid_casadi.robot.inertia import pseudo_inertia

WEIGHT = 1e-3  # of the divergence from the fit's bodies, in squared standard deviations
UNKNOWN_SPEED = 2.0  # rad/s, velocity limit of a robot that states none
ATTEMPTS = 20  # draws for one sample, if the solver finds no consistent parameters
POSES = 500  # at which the mass matrix of a draw is checked


@dataclass(frozen=True, eq=False)
class Posterior:
    """Base values (p,) and shapes (s,) of a fit with their covariance.

    ``parameters`` (10 n + m,) are link parameters and coefficients that give the values.
    """

    compiled: Compiled
    values: Array
    shapes: Array
    covariance: Array
    parameters: Array

    def draws(self, count: int, *, seed: int = 0) -> Iterator[tuple[Array, Array]]:
        """Yield consistent parameters (10 n + m,) and shapes (s,); see `Fit.sample`."""
        random, p, model = np.random.default_rng(seed), len(self.values), self.compiled.model
        mean, problem = np.concatenate([self.values, self.shapes]), self.problem
        whitening, root = self._roots
        lower, upper = (
            np.array([getattr(s, end) for s in model.shapes]) for end in ("lower", "upper")
        )
        solver, found, failures = ConvexSolver(problem), 0, 0
        while found < count:
            drawn = mean + root @ random.standard_normal(root.shape[1])
            parameters = model.base.lift(drawn[:p], self.parameters)
            if not _consistent(problem, parameters):
                try:
                    nearest = _squared_distance(whitening[:, :p], drawn[:p])
                    parameters = solver.solve(nearest, WEIGHT)
                except NoSolution:
                    failures += 1
                    if failures > ATTEMPTS * count:
                        raise
                    continue
            found += 1
            yield parameters, np.clip(drawn[p:], lower, upper)

    def certificate(self, parameters: Array, own: Certificate | None) -> Certificate | None:
        """Return the certificate of the fit that was sampled, checked for a draw."""
        if own is None:
            return None
        links = parameters[: 10 * self.compiled.n]
        return replace(
            own,
            pseudo_inertia_eigenvalue=pseudo_inertia_eigenvalues(links),
            mass_matrix_eigenvalue=least_mass_matrix_eigenvalue(
                self.compiled, links, poses=POSES, seed=0
            ),
            poses=POSES,
            least_dissipation=least_dissipation(self.problem.friction, parameters[len(links) :]),
        )

    @cached_property
    def _roots(self) -> tuple[Array, Array]:
        """W (k, p + s) and L (p + s, k): |W·δ|² is δ in standard deviations, C = L·Lᵀ."""
        return prior_rows(self.covariance), square_root(self.covariance)

    @cached_property
    def problem(self) -> FeasibleProblem:
        """Constraints of consistent parameters, with the fit's bodies as references."""
        model, robot, links = self.compiled.model, self.compiled.model.robot, self._links
        lower, upper = position_range(robot)
        limit = robot.limit("velocity")
        poses = np.random.default_rng(0).uniform(lower, upper, (200, model.n))
        friction = np.zeros((0, len(model.columns)))
        if not any(isinstance(p.effect, ArmEffect) for p in model.placements):
            friction = dissipation_rows(
                self.compiled,
                self.shapes,
                velocity=np.where(np.isfinite(limit), limit, UNKNOWN_SPEED),
                load=np.abs(self.compiled.gravity(poses, links)).max(axis=0),
                temperature=np.zeros(model.n),
                lower=lower,
                upper=upper,
            )
        references = np.array([pseudo_inertia(b) for b in links.reshape(-1, 10)])
        typical = _squared_distance(self._roots[0][:, : len(self.values)], self.values)
        return FeasibleProblem.of(model, references, friction, typical)

    @property
    def _links(self) -> Array:
        return self.parameters[: 10 * self.compiled.n]


def _squared_distance(rows: Array, values: Array) -> Factor:
    """Return the factor whose misfit is |rows·(β − values)|²."""
    p = len(values)
    target = np.zeros((p + 1, p + 1))
    _, r = np.linalg.qr(np.column_stack([rows, rows @ values]))
    target[: len(r)] = r
    return Factor(target, 1)


def _consistent(problem: FeasibleProblem, parameters: Array) -> bool:
    """Whether parameters satisfy all constraints of the problem."""
    links, coefficients = parameters[: 10 * problem.n], parameters[10 * problem.n :]
    bodies = [np.linalg.eigvalsh(pseudo_inertia(b))[0] for b in links.reshape(-1, 10)]
    return bool(
        min(bodies) > 0.0
        and np.all((coefficients >= problem.lower) & (coefficients <= problem.upper))
        and np.all(problem.friction @ coefficients >= 0.0)
    )
