"""The convex problem of physically possible parameters, apart from what solves it.

Minimize over link pseudo-inertias P_i and effect coefficients c

    ‖R·(combination·[π(P); c]) − z‖² / rows + λ·Σ_i D(P_i ‖ P̄_i),
    D(P ‖ P̄) = tr(P̄⁻¹P) − log det(P̄⁻¹P) − 4,

subject to P_i ⪰ margin·P̄_i, bounds of the coefficients, dissipative friction, and what the user
knows of masses and centres of mass. [R | z] is the triangular factor of the weighted rows: the
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
UNSEEN = 1e-10  # of the largest column: a coefficient without torque stays at zero
#: π ↦ its pseudo-inertia as 16 numbers, row after row
PSEUDO = np.array([pseudo_inertia(unit).ravel() for unit in np.eye(10)]).T


@dataclass(frozen=True, eq=False)
class FeasibleProblem:
    """What stays the same while data and λ change.

    Attributes
    ----------
    combination : (p, 10 n + m)
        β = combination @ [link parameters; coefficients].
    references : (n, 4, 4)
        P̄, positive definite.
    lower, upper : (m,)
        Bounds of the coefficients, infinite where there are none.
    friction : (K, m)
        Rows whose product with the coefficients must not be negative.
    typical : Factor
        Of the data, or of data like it; for scaling alone.
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
        """Matrix (10 n + m, 10 n + m): scaled unknowns to parameters.

        Ten scaled unknowns of a link are the link parameters of Q with P = U·Q·Uᵀ, so that
        the reference is the unit matrix; coefficients are in units of their column's size.
        """
        links = 10 * self.n
        matrix = np.zeros((self.combination.shape[1],) * 2)
        for i, root in enumerate(self.roots):
            back = np.linalg.inv(root)
            block = np.linalg.lstsq(np.kron(back, back) @ PSEUDO, PSEUDO, rcond=None)[0]
            matrix[10 * i : 10 * i + 10, 10 * i : 10 * i + 10] = block
        size = self._column_sizes
        matrix[links:, links:] = np.diag(1.0 / np.where(self.seen, size, 1.0))
        return matrix

    @cached_property
    def _column_sizes(self) -> Array:
        r = self.typical.r[:, :-1] / np.sqrt(max(self.typical.rows, 1))
        return np.asarray(np.linalg.norm(r @ self.combination[:, 10 * self.n :], axis=0))

    @cached_property
    def seen(self) -> NDArray[np.bool_]:
        """Coefficients (m,) that some torque in the data depends on."""
        size = self._column_sizes
        return np.asarray(size > UNSEEN * size.max(initial=0.0))

    @cached_property
    def known_bodies(self) -> list[tuple[Array, float]]:
        """Rows (10 n,) and bounds b, row @ link parameters ≥ b, of what the user knows."""
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
        """Return [R | z] (p + 1, p + 1) per square root of a row, zero rows added if need be."""
        width = self.combination.shape[0] + 1
        padded = np.zeros((width, width))
        r = factor.r if len(factor.r) <= width else triangular(factor.r)
        padded[: len(r)] = r / np.sqrt(max(factor.rows, 1))
        return padded

    def divergences(self, parameters: Array) -> Array:
        """Return each link's divergence (n,) from its reference."""
        found = []
        for link, root in zip(parameters[: 10 * self.n].reshape(-1, 10), self.roots, strict=True):
            back = np.linalg.inv(root)
            q = back @ pseudo_inertia(link) @ back.T
            found.append(np.trace(q) - np.linalg.slogdet(q)[1] - 4.0)
        return np.array(found)

    def cost(self, factor: Factor, weight: float, parameters: Array) -> float:
        """Return the objective at given parameters (10 n + m,)."""
        misfit = factor.misfit(self.combination @ parameters) / max(factor.rows, 1)
        return float(misfit + weight * np.sum(self.divergences(parameters)))

    def within_bounds(self, parameters: Array) -> Array:
        """Return parameters with coefficients moved onto bounds that rounding crossed."""
        moved = parameters.copy()
        links = 10 * self.n
        moved[links:] = np.clip(moved[links:], self.lower, self.upper)
        moved[links:][~self.seen] = np.clip(0.0, self.lower, self.upper)[~self.seen]
        return moved
