"""Convex problem of physically consistent parameters.

Minimize over link pseudo-inertias P_i and effect coefficients c

    ‖R·(combination·[π(P); c]) − z‖² / rows + λ·Σ_i D(P_i ‖ P̄_i),
    D(P ‖ P̄) = tr(P̄⁻¹P) − log det(P̄⁻¹P) − 4,

subject to P_i ⪰ margin·P̄_i, bounds of the coefficients, dissipative friction, and given bounds
on masses and centres of mass. [R | z] is the triangular factor of the weighted rows: the
size of the problem does not depend on the number of samples. D is the entropic (Bregman)
divergence of Lee, Wensing, Park, "Geometric robot dynamic identification: a convex programming
approach", IEEE T-RO 2020; it does not depend on the choice of frames or units.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from lieid_casadi.compiled.triangular_factors import triangular
from lieid_casadi.identification.feasible.options import FeasibleOptions
from lieid_casadi.identification.regression.least_squares import Factor
from lieid_casadi.robot.inertia import pseudo_inertia

Array = NDArray[np.float64]
NEGLIGIBLE = 1e-10  # of the largest column: coefficients without torque are set to zero
#: link parameters (10,) to the pseudo-inertia as 16 numbers, row by row
PSEUDO = np.array([pseudo_inertia(unit).ravel() for unit in np.eye(10)]).T


@dataclass(frozen=True, eq=False)
class FeasibleProblem:
    """Constraints and references of the problem, independent of data and λ.

    Attributes
    ----------
    combination : (p, 10 n + m)
        β = combination @ [link parameters; coefficients].
    references : (n, 4, 4)
        Pseudo-inertias P̄, positive definite.
    lower, upper : (m,)
        Bounds of the coefficients, infinite where there are none.
    friction : (K, m)
        Rows whose product with the coefficients is constrained to be not negative.
    typical : Factor
        Of the data, or of similar data; used for scaling only.
    options : FeasibleOptions
    """

    combination: Array
    references: Array
    lower: Array
    upper: Array
    friction: Array
    typical: Factor
    options: FeasibleOptions

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
    def active(self) -> NDArray[np.bool_]:
        """Coefficients (m,) with an influence on some torque in the data."""
        size = self._column_sizes
        return np.asarray(size > NEGLIGIBLE * size.max(initial=0.0))

    @cached_property
    def body_bounds(self) -> list[tuple[Array, float]]:
        """Rows (10 n,) and bounds b of the given constraints row @ link parameters ≥ b."""
        found: list[tuple[Array, float]] = []
        mass = np.zeros(10 * self.n)
        if self.options.total_mass is not None:
            mass[::10] = 1.0
            low, high = self.options.total_mass
            found += [(mass, low), (-mass, -high)]
        unit = np.eye(10 * self.n)
        for link, (low, high) in self.options.link_mass.items():
            found += [(unit[10 * link], low), (-unit[10 * link], -high)]
        for link, corners in self.options.com_box.items():
            for axis in range(3):
                m, moment = unit[10 * link], unit[10 * link + 1 + axis]
                found += [(moment - corners[0][axis] * m, 0.0)]
                found += [(corners[1][axis] * m - moment, 0.0)]
        return found

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

    def cost(self, factor: Factor, weight: float, parameters: Array) -> float:
        """Return the objective.

        Parameters
        ----------
        factor : Factor
            Of the weighted rows.
        weight : float
            λ.
        parameters : (10 n + m,)
        """
        misfit = factor.misfit(self.combination @ parameters) / max(factor.rows, 1)
        return float(misfit + weight * np.sum(self.divergences(parameters)))

    def within_bounds(self, parameters: Array) -> Array:
        """Return parameters (10 n + m,) with coefficients clipped to their bounds."""
        moved = parameters.copy()
        links = 10 * self.n
        moved[links:] = np.clip(moved[links:], self.lower, self.upper)
        moved[links:][~self.active] = np.clip(0.0, self.lower, self.upper)[~self.active]
        return moved
