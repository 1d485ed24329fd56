"""Convex problem of physically consistent parameters.

Minimize over link pseudo-inertias P_i and effect coefficients c

    ‖R·(combination·[π(P); c]) − z‖² / rows + λ·Σ_i D(P_i ‖ P̄_i),
    D(P ‖ P̄) = tr(P̄⁻¹P) − log det(P̄⁻¹P) − 4,

subject to P_i ⪰ margin·P̄_i, bounds of the coefficients, and dissipative friction. [R | z] is the
triangular factor of the weighted rows: the size of the problem does not depend on the number of
samples. D is the entropic (Bregman) divergence of Lee, Wensing, Park, "Geometric robot dynamic
identification: a convex programming approach", IEEE T-RO 2020; it does not depend on the choice of
frames or units.
"""

from __future__ import annotations

import logging
import time
import warnings
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from lieid_casadi.arrays import Array, Mask
from lieid_casadi.compiled.triangular_factors import triangular
from lieid_casadi.errors import IdentificationError, LieidWarning, NominalInertiaWarning, NoSolution
from lieid_casadi.identification.regression.least_squares import Factor, unit_columns
from lieid_casadi.identification.regression.priors import sphere_between_joints
from lieid_casadi.model import Model
from lieid_casadi.robot.inertia import body_inertia, link_parameters, pseudo_inertia

FLAT = 1e-6  # smallest ratio of second moments of a body that is used as it is
CORRECTED_FLATNESS = 1e-3  # smallest ratio of second moments of a corrected body
CORRECTED_GYRATION = 0.01  # m, smallest radius of gyration of a corrected body
DENSITY = (100.0, 5000.0)  # kg/m³, range for spheres


def reference_bodies(model: Model, factor: Factor) -> tuple[Array, tuple[LieidWarning, ...]]:
    """Return the reference pseudo-inertias (n, 4, 4), positive definite, and warnings.

    The reference of a link is its nominal inertia; one that is physically impossible (flat, or
    violating the triangle inequalities) is corrected and a warning returned. Links without
    nominal inertia get uniform spheres half-way to the next joint, of the density that fits best.
    """
    found: list[LieidWarning] = []
    links = []
    for joint in model.robot.joints:
        if joint.link is None:
            links.append(np.full(10, np.nan))
            continue
        name = joint.link_name or joint.name
        if joint.link[0] <= 0.0:
            raise IdentificationError(
                f"robot {model.robot.name!r}: link {name!r} has a mass of {joint.link[0]:g} kg; "
                "expected a positive mass, or none"
            )
        corrected = _corrected(joint.link)
        if corrected is not joint.link:
            found.append(
                NominalInertiaWarning(
                    f"the nominal inertia of link {name!r} is physically impossible; method "
                    "feasible uses a possible one near it as its reference; correct the robot "
                    "description"
                )
            )
        links.append(corrected)
    stated = _with_spheres(model, np.array(links), factor)
    return np.array([pseudo_inertia(link) for link in stated]), tuple(found)


def _corrected(link: Array) -> Array:
    """Return link parameters (10,) with positive second moments; the same array if they are."""
    body = body_inertia(link)
    moments, axes = np.linalg.eigh(0.5 * np.trace(body.inertia) * np.eye(3) - body.inertia)
    if moments[0] > FLAT * max(float(moments[-1]), FLAT * body.mass):
        return link
    least = max(CORRECTED_FLATNESS * float(moments[-1]), body.mass * CORRECTED_GYRATION**2)
    sigma = axes @ np.diag(np.maximum(moments, least)) @ axes.T
    return link_parameters(body.mass, body.com, np.trace(sigma) * np.eye(3) - sigma)


def _with_spheres(model: Model, links: Array, factor: Factor) -> Array:
    missing = np.isnan(links[:, 0])
    if not missing.any():
        return links
    unit = (sphere_between_joints(model.robot, i) for i in range(model.n))
    spheres = np.array([4.0 / 3.0 * np.pi * radius**3 * sphere for sphere, radius in unit])
    stated = np.where(missing[:, None], 0.0, links)
    density = _density(model, factor, stated, np.where(missing[:, None], spheres, 0.0))
    return np.where(missing[:, None], density * spheres, links)


def _density(model: Model, factor: Factor, stated: Array, spheres: Array) -> float:
    """Return the density that fits best, with free effect coefficients, kg/m³."""
    combination, links = model.base.combination, 10 * model.n
    r, z = factor.r[:, :-1], factor.r[:, -1]
    columns = r @ combination
    matrix = np.column_stack([columns[:, :links] @ spheres.ravel(), columns[:, links:]])
    target = z - columns[:, :links] @ stated.ravel()
    scaled, scale = unit_columns(matrix)
    best = np.linalg.lstsq(scaled, target, rcond=1e-9)[0][0] / scale[0]
    return float(np.clip(best, *DENSITY))


NEGLIGIBLE = 1e-10  # of the largest column: coefficients without torque are set to zero
#: link parameters (10,) to the pseudo-inertia as 16 numbers, row by row
PSEUDO = np.array([pseudo_inertia(unit).ravel() for unit in np.eye(10)]).T


@dataclass(frozen=True, eq=False)
class FeasibleProblem:
    """Constraints and references of the problem, independent of data and λ."""

    combination: Array  # (p, 10 n + m): β = combination @ [link parameters; coefficients]
    references: Array  # (n, 4, 4): pseudo-inertias P̄, positive definite
    lower: Array  # (m,): bounds of the coefficients, infinite where there are none
    upper: Array  # (m,): bounds of the coefficients, infinite where there are none
    #: (K, m): rows whose product with the coefficients is constrained to be not negative
    friction: Array
    typical: Factor  # of the data, or of similar data; used for scaling only

    @classmethod
    def of(
        cls, model: Model, references: Array, friction: Array, typical: Factor
    ) -> FeasibleProblem:
        """Return the problem of a model."""
        lower, upper = (
            np.array([getattr(c, x) for c in model.columns]) for x in ("lower", "upper")
        )
        return cls(model.base.combination, references, lower, upper, friction, typical)

    @property
    def n(self) -> int:
        """Number of links."""
        return len(self.references)

    @cached_property
    def roots(self) -> Array:
        """Upper triangular U (n, 4, 4) with U·Uᵀ = P̄."""
        flipped = self.references[:, ::-1, ::-1]
        return np.asarray(np.linalg.cholesky(flipped)[:, ::-1, ::-1])

    @cached_property
    def scaling(self) -> Array:
        """Matrix (10 n + m, 10 n + m) from scaled unknowns to parameters.

        The ten scaled unknowns of a link are the link parameters of Q with P = U·Q·Uᵀ, so that
        the reference is the unit matrix; coefficients are multiplied by their column's norm.
        """
        links = 10 * self.n
        matrix = np.zeros((self.combination.shape[1],) * 2)
        for i, root in enumerate(self.roots):
            back = np.linalg.inv(root)
            block = np.linalg.lstsq(np.kron(back, back) @ PSEUDO, PSEUDO, rcond=None)[0]
            matrix[10 * i : 10 * i + 10, 10 * i : 10 * i + 10] = block
        size = self._column_sizes
        matrix[links:, links:] = np.diag(1.0 / np.where(self.active, size, 1.0))
        return matrix

    @cached_property
    def _column_sizes(self) -> Array:
        r = self.typical.r[:, :-1] / np.sqrt(max(self.typical.rows, 1))
        return np.asarray(np.linalg.norm(r @ self.combination[:, 10 * self.n :], axis=0))

    @cached_property
    def active(self) -> Mask:
        """Coefficients (m,) with an influence on some torque in the data."""
        size = self._column_sizes
        return np.asarray(size > NEGLIGIBLE * size.max(initial=0.0))

    def reduced(self, factor: Factor) -> Array:
        """Return [R | z] (p + 1, p + 1) divided by √rows, padded with zero rows."""
        width = self.combination.shape[0] + 1
        padded = np.zeros((width, width))
        r = factor.r if len(factor.r) <= width else triangular(factor.r)
        padded[: len(r)] = r / np.sqrt(max(factor.rows, 1))
        return padded

    def divergences(self, parameters: Array) -> Array:
        """Return the divergence of each link from its reference (n,), at parameters (10 n + m,)."""
        found = []
        for link, root in zip(parameters[: 10 * self.n].reshape(-1, 10), self.roots, strict=True):
            back = np.linalg.inv(root)
            q = back @ pseudo_inertia(link) @ back.T
            found.append(np.trace(q) - np.linalg.slogdet(q)[1] - 4.0)
        return np.array(found)

    def within_bounds(self, parameters: Array) -> Array:
        """Return parameters (10 n + m,) with coefficients clipped to their bounds."""
        moved = parameters.copy()
        links = 10 * self.n
        moved[links:] = np.clip(moved[links:], self.lower, self.upper)
        moved[links:][~self.active] = np.clip(0.0, self.lower, self.upper)[~self.active]
        return moved


log = logging.getLogger("lieid_casadi")
TOLERANCE = 1e-8
#: Relative gap to the least cost that is accepted where rounding stops the solver earlier; the
#: constraints are met to `TOLERANCE` in any case.
LARGEST_GAP = 1e-6
MAX_ITERATIONS = 200
MARGIN = 1e-3  # of its reference body, by which each pseudo-inertia is positive definite at least
FRICTION_MARGIN = 1e-6  # of the joint's noise: keeps friction dissipative within the tolerance

RELAX = "give a larger regularization, or record more excitation"
STATUS = {
    "infeasible": (
        "no parameters satisfy all constraints (proved by the solver): the bounds of the effects "
        "contradict each other"
    ),
    "infeasible_inaccurate": f"probably no parameters satisfy all constraints; {RELAX}",
    "unbounded": f"the cost has no minimum; {RELAX}",
    "unbounded_inaccurate": f"the cost has probably no minimum; {RELAX}",
    "user_limit": f"the solver reached its limit of {MAX_ITERATIONS} iterations; {RELAX}",
    "solver_error": f"the solver did not reach its accuracy; {RELAX}",
}


class ConvexSolver:
    """Solver of one problem; compiled at the first call, reused for other data and other λ."""

    def __init__(self, problem: FeasibleProblem) -> None:
        import cvxpy as cp

        self.problem = problem
        p, total = problem.combination.shape
        links = 10 * problem.n
        self._unknowns = cp.Variable(total)
        self._matrix = cp.Parameter((p + 1, p))
        self._target = cp.Parameter(p + 1)
        self._weight = cp.Parameter(nonneg=True)
        to_base = problem.combination @ problem.scaling
        residual = self._matrix @ (to_base @ self._unknowns) - self._target
        unit = np.eye(4)
        divergence, constraints = 0.0, []
        for i in range(problem.n):
            body = cp.reshape(PSEUDO @ self._unknowns[10 * i : 10 * i + 10], (4, 4), order="C")
            divergence += cp.trace(body) - cp.log_det(body)
            constraints.append(body >> MARGIN * unit)
        rows, bounds = linear_constraints(problem)
        if len(rows):
            constraints.append((rows @ problem.scaling) @ self._unknowns >= bounds)
        inactive = links + np.flatnonzero(~problem.active)
        if len(inactive):
            constraints.append(self._unknowns[inactive] == 0.0)
        cost = cp.sum_squares(residual) + self._weight * divergence
        self._program = cp.Problem(cp.Minimize(cost), constraints)

    def solve(self, factor: Factor, weight: float) -> Array:
        """Return parameters (10 n + m,)."""
        import cvxpy as cp

        reduced = self.problem.reduced(factor)
        self._matrix.value, self._target.value = reduced[:, :-1], reduced[:, -1]
        self._weight.value = weight
        began = time.perf_counter()
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of an accuracy between `TOLERANCE` and `LARGEST_GAP`
            try:
                self._program.solve(
                    solver=cp.CLARABEL,
                    max_iter=MAX_ITERATIONS,
                    tol_gap_abs=TOLERANCE,
                    tol_gap_rel=TOLERANCE,
                    tol_feas=TOLERANCE,
                    reduced_tol_gap_abs=LARGEST_GAP,
                    reduced_tol_gap_rel=LARGEST_GAP,
                    reduced_tol_feas=TOLERANCE,
                )
                status = str(self._program.status)
            except cp.SolverError:
                status = "solver_error"
        log.debug("feasible: λ %.3g, %s in %.3f s", weight, status, time.perf_counter() - began)
        if status not in (cp.OPTIMAL, cp.OPTIMAL_INACCURATE) or self._unknowns.value is None:
            reason = STATUS.get(status, f"the solver stopped with status {status}; {RELAX}")
            raise NoSolution(f"physically consistent parameters: {reason}")
        return self.problem.within_bounds(self.problem.scaling @ self._unknowns.value)

    def base_values(self, factor: Factor, weight: float) -> Array:
        """Return base values (p,); see `solve`."""
        return np.asarray(self.problem.combination @ self.solve(factor, weight))


def linear_constraints(problem: FeasibleProblem) -> tuple[Array, Array]:
    """Return rows (K, 10 n + m) and bounds (K,) of the constraints row @ parameters ≥ bound.

    Rows have unit norm in scaled unknowns.
    """
    links, total = 10 * problem.n, problem.combination.shape[1]
    rows, bounds = [np.zeros((0, total))], [np.zeros(0)]
    unit = np.eye(total)[links:]
    for side, sign in ((problem.lower, 1.0), (-problem.upper, -1.0)):
        finite = np.isfinite(side) & problem.active
        rows.append(sign * unit[finite])
        bounds.append(side[finite])
    bodies, limits = _unit_norm(problem, np.vstack(rows), np.concatenate(bounds))
    active = problem.friction * problem.active
    friction = np.zeros((len(active), total))
    friction[:, links:] = active
    friction = friction[np.any(active != 0.0, axis=1)]
    friction, zeros = _unit_norm(problem, friction, np.zeros(len(friction)))
    return np.vstack([bodies, friction]), np.concatenate([limits, zeros + FRICTION_MARGIN])


def _unit_norm(problem: FeasibleProblem, rows: Array, bounds: Array) -> tuple[Array, Array]:
    size = np.linalg.norm(rows @ problem.scaling, axis=1)
    size[size == 0.0] = 1.0
    return rows / size[:, None], bounds / size
