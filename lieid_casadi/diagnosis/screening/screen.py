"""What each candidate would explain that the fitted model cannot (Frisch, Waugh, Lovell).

Only the part of a column outside the span of the model's own columns can reduce the residual.
With an orthonormal basis Q of the model's columns neither these parts nor refits have to be
formed: gain = gᵀ·G⁻¹·g with g = Cᵀr and G = CᵀC − (QᵀC)ᵀ(QᵀC).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lieid_casadi.diagnosis.options import ABSORBED, DiagnosisOptions
from lieid_casadi.diagnosis.screening.baseline import Baseline
from lieid_casadi.diagnosis.screening.candidate_columns import CandidateColumns
from lieid_casadi.diagnosis.screening.coordinates import Coordinates

Array = NDArray[np.float64]
#: Of the Gram matrix of unit columns: below it a direction is numerically dependent.
LEAST_EIGENVALUE = ABSORBED**2 * 1e2


@dataclass(frozen=True, eq=False)
class Gains:
    """The gain of every group of candidate columns.

    Attributes
    ----------
    candidates : CandidateColumns
    gain : (G,)
        Fall of the whitened sum of squares; 0 where a coefficient has a sign that is physically
        impossible, or where the group is excluded by the options.
    remaining : (G,)
        Largest part, 0 to 1, of the group's columns that the baseline does not span.
    rank : (G,) int
        Number of directions that the baseline does not span.
    """

    candidates: CandidateColumns[Any]
    gain: Array
    remaining: Array
    rank: NDArray[np.intp]


@dataclass(frozen=True, eq=False)
class Screening(Gains):
    """The gain of every group of candidate columns added to a baseline.

    Attributes
    ----------
    baseline : Baseline
    roots : (m, k)
        Row c: column c's row of the inverse square root of its group's Gram matrix.
    coordinates : Coordinates
        Of the columns along the span of the baseline.
    """

    baseline: Baseline
    roots: Array
    coordinates: Coordinates

    def statistic(self, noise: Array) -> Array:
        """Return the gains (G, B) that white rows (R, B) would give."""
        products = _products(self.candidates, self.baseline, noise)
        products -= self.coordinates.products(self.baseline, noise)
        return _gains(self.candidates, self.roots, products)


def screen(
    candidates: CandidateColumns[Any], baseline: Baseline, options: DiagnosisOptions | None
) -> Screening:
    """Return the gain of every group added to a baseline.

    Parameters
    ----------
    candidates : CandidateColumns
        Whitened as the baseline is.
    baseline : Baseline
    options : DiagnosisOptions or None
        They exclude groups that rest on few rows or on a small part of their own; with None no
        group is excluded, and signs are not checked.
    """
    along = Coordinates.of(candidates, baseline)
    products = _products(candidates, baseline, baseline.residual[:, None])[:, 0]
    found, roots = _gains_of(candidates, along.gram(), products, options)
    return Screening(candidates, found.gain, found.remaining, found.rank, baseline, roots, along)


class SelectionState:
    """Gains of all groups given any selected groups, from inner products computed once.

    With C the columns outside the model's span and S the selected ones, gains follow from
    CᵀC − CᵀS·(SᵀS)⁺·SᵀC within the groups and from Cᵀr − CᵀS·(SᵀS)⁺·Sᵀr. The inner products CᵀS
    of a group are computed when it is first selected, from those of the columns and of their
    coordinates along the model's span; no baseline is formed again.

    Parameters
    ----------
    candidates : CandidateColumns
        Whitened as the baseline is.
    baseline : Baseline
        Of the model.
    options : DiagnosisOptions or None
        As for `screen`.
    """

    def __init__(
        self,
        candidates: CandidateColumns[Any],
        baseline: Baseline,
        options: DiagnosisOptions | None,
    ) -> None:
        self.candidates, self.baseline, self._options = candidates, baseline, options
        self._along = Coordinates.of(candidates, baseline)
        self._gram = self._along.gram()
        self._products = _products(candidates, baseline, baseline.residual[:, None])[:, 0]
        self._with: dict[int, Array] = {}
        self._parts: dict[int, Array] = {}
        self._given: dict[frozenset[int], Gains] = {}

    def given(self, groups: Sequence[int]) -> Gains:
        """Return the gain of every group in addition to the model and the selected groups."""
        key = frozenset(groups)
        if key not in self._given:
            gram, products = self._gram, self._products
            if key:
                axes, along = self._axes(sorted(key))
                gram, products = gram.copy(), products - axes @ along
                for offset in range(len(gram)):
                    count = len(axes) - offset
                    gram[offset, :count] -= np.einsum("cr,cr->c", axes[:count], axes[offset:])
            self._given[key], _ = _gains_of(self.candidates, gram, products, self._options)
        return self._given[key]

    def _axes(self, groups: Sequence[int]) -> tuple[Array, Array]:
        """Return inner products of all columns (m, r), and of the residual (r,), with a basis.

        The basis of the groups' columns is orthonormal: S·W with (SᵀS)⁺ = W·Wᵀ.
        """
        own = np.concatenate([self.candidates.columns_of(g) for g in groups])
        inner = np.hstack([self._inner_with(g) for g in groups])
        size = np.sqrt(self.candidates.inner[0, own])
        size[size == 0.0] = 1.0
        gram = inner[own] / np.outer(size, size)
        sizes, axes = np.linalg.eigh(0.5 * (gram + gram.T))
        seen = sizes > LEAST_EIGENVALUE
        root = axes[:, seen] / np.sqrt(sizes[seen]) / size[:, None]
        return inner @ root, root.T @ self._products[own]

    def _inner_with(self, group: int) -> Array:
        """Return the inner products (m, k) of all columns with a group's, outside the model."""
        if group not in self._with:
            self._with[group] = self._along.inner_with(group)
        return self._with[group]

    def _part(self, group: int) -> Array:
        if group not in self._parts:
            self._parts[group] = self.baseline.part(self.candidates.stacked(group))
        return self._parts[group]

    def with_groups(self, groups: Sequence[int]) -> Baseline:
        """Return the baseline of the model with groups added."""
        baseline = self.baseline
        for group in groups:
            baseline = baseline.with_part(self._part(group))
        return baseline


def _gains_of(
    candidates: CandidateColumns[Any],
    gram: Array,
    products: Array,
    options: DiagnosisOptions | None,
) -> tuple[Gains, Array]:
    """Return the gains, and the inverse roots (m, k), from inner products.

    Parameters
    ----------
    candidates : CandidateColumns
    gram : (k, m)
        Of columns outside the span, within groups by offset.
    products : (m,)
        Of the columns with the residual.
    options : DiagnosisOptions or None
    """
    roots, remaining, rank = _inverse_roots(candidates, gram, candidates.inner[0])
    gain = _gains(candidates, roots, products[:, None])[:, 0]
    if options is not None:
        values = _values(candidates, roots, products)
        gain = np.where(_selectable(candidates, values, remaining, options), gain, 0.0)
    return Gains(candidates, gain, remaining, rank), roots


def _selectable(
    candidates: CandidateColumns[Any], values: Array, remaining: Array, options: DiagnosisOptions
) -> NDArray[np.bool_]:
    """Mark the groups (G,) with possible coefficients (m,), enough rows and a part of their own."""
    if not len(values):
        return np.zeros(0, bool)
    allowed = values >= candidates.lower_bounds - 1e-12
    fine = np.logical_and.reduceat(allowed, candidates.start)
    fine &= candidates.support >= options.least_support
    points = np.bincount(candidates.owner_index, minlength=len(candidates.owners))
    on_grid = points[candidates.owner_index] > 1
    return np.asarray(fine & ~(on_grid & (remaining < options.least_own_part)))


def _inverse_roots(
    candidates: CandidateColumns[Any], gram: Array, norms: Array
) -> tuple[Array, Array, NDArray[np.intp]]:
    """Return inverse square roots of the Gram matrices.

    Returns
    -------
    roots : (m, k)
        Row c: column c's row of its group's inverse square root.
    remaining : (G,)
    rank : (G,) int
    """
    width = len(gram)
    roots = np.zeros((candidates.count, width))
    remaining = np.zeros(len(candidates.size))
    rank = np.zeros(len(candidates.size), dtype=np.intp)
    scale = np.sqrt(np.where(norms > 0.0, norms, 1.0))
    for k in np.unique(candidates.size):
        groups = np.flatnonzero(candidates.size == k)
        first = candidates.start[groups]
        matrix = np.empty((len(groups), k, k))
        for a in range(k):
            for b in range(a, k):
                entry = gram[b - a, first + a] / (scale[first + a] * scale[first + b])
                matrix[:, a, b] = matrix[:, b, a] = entry
        single = k == 1  # whose root needs no decomposition
        sizes, axes = (matrix[:, 0], np.ones_like(matrix)) if single else np.linalg.eigh(matrix)
        seen = sizes > LEAST_EIGENVALUE
        remaining[groups] = np.sqrt(np.clip(sizes[:, -1], 0.0, 1.0))
        rank[groups] = seen.sum(axis=1)
        inverse = np.where(seen, 1.0 / np.sqrt(np.where(seen, sizes, 1.0)), 0.0)
        root = axes * inverse[:, None, :]
        for a in range(k):
            roots[first + a, :k] = root[:, a] / scale[first + a, None]
    return roots, remaining, rank


def _products(candidates: CandidateColumns[Any], baseline: Baseline, rest: Array) -> Array:
    """Return Cᵀ·rest (m, B) for rows (R, B)."""
    products = np.zeros((candidates.count, rest.shape[1]))
    for j, own in enumerate(candidates.joints):
        products[own.columns] += own.matrix.T @ rest[baseline.joint(j)]
    return products


def _gains(candidates: CandidateColumns[Any], roots: Array, products: Array) -> Array:
    """Return the gain of each group (G, B) for products (m, B)."""
    gains = np.zeros((len(candidates.size), products.shape[1]))
    for direction in range(roots.shape[1]):
        along = np.add.reduceat(roots[:, direction, None] * products, candidates.start, axis=0)
        gains += along**2
    return gains


def _values(candidates: CandidateColumns[Any], roots: Array, products: Array) -> Array:
    """Return the least-squares coefficients (m,) of every group, each group alone."""
    values = np.zeros(candidates.count)
    owner = np.repeat(np.arange(len(candidates.size)), candidates.size)
    for direction in range(roots.shape[1]):
        along = np.add.reduceat(roots[:, direction] * products, candidates.start)
        values += roots[:, direction] * along[owner]
    return values
