"""What each candidate would explain that the fitted model cannot (Frisch, Waugh, Lovell).

Only the part of a column outside the span of the model's own columns can reduce the residual.
With an orthonormal basis Q of the model's columns neither these parts nor refits have to be
formed: gain = gᵀ·G⁻¹·g with g = Cᵀr and G = CᵀC − (QᵀC)ᵀ(QᵀC).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lieid_casadi.diagnosis.options import ABSORBED, DiagnosisOptions
from lieid_casadi.diagnosis.screening.baseline import Baseline
from lieid_casadi.diagnosis.screening.candidate_columns import CandidateColumns

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Screening:
    """The gain of every group of candidate columns added to a baseline.

    Attributes
    ----------
    candidates : CandidateColumns
    baseline : Baseline
    gain : (G,)
        Fall of the whitened sum of squares; 0 where a coefficient has a sign that is physically
        impossible, or where the group is excluded by the options.
    remaining : (G,)
        Largest part, 0 to 1, of the group's columns that the baseline does not span.
    rank : (G,) int
        Number of directions that the baseline does not span.
    """

    candidates: CandidateColumns[Any]
    baseline: Baseline
    gain: Array
    remaining: Array
    rank: NDArray[np.intp]
    _roots: Array

    @cached_property
    def parameters(self) -> Array:
        """Number of parameters that each group adds to the model (G,)."""
        each = np.array([c.parameters for c in self.candidates.owners])
        return np.asarray(each[self.candidates.owner_index], dtype=float)

    def statistic(self, noise: Array) -> Array:
        """Return the gains (G, B) that white rows (R, B) would give."""
        rest = self.baseline.project_out(noise)
        return _gains(self.candidates, self._roots, _products(self.candidates, self.baseline, rest))


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
    gram, norms = _grams(candidates, baseline)
    roots, remaining, rank = _inverse_roots(candidates, gram, norms)
    products = _products(candidates, baseline, baseline.residual[:, None])
    gain = _gains(candidates, roots, products)[:, 0]
    if options is not None:
        values = _values(candidates, roots, products[:, 0])
        gain = np.where(_selectable(candidates, values, remaining, options), gain, 0.0)
    return Screening(candidates, baseline, gain, remaining, rank, roots)


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


def _grams(candidates: CandidateColumns[Any], baseline: Baseline) -> tuple[Array, Array]:
    """Return inner products of the projected columns (k, m) by offset, and squared norms (m,)."""
    inner = candidates.inner - candidates.inner_in_model(baseline.model, baseline.ends)
    if baseline.added.shape[1]:
        inner -= candidates.inner_in_span(baseline.added, baseline.ends)
    return inner, candidates.inner[0]


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
        sizes, axes = np.linalg.eigh(matrix)
        seen = sizes > ABSORBED**2 * 1e2
        remaining[groups] = np.sqrt(np.clip(sizes[:, -1], 0.0, 1.0))
        rank[groups] = seen.sum(axis=1)
        inverse = np.where(seen, 1.0 / np.sqrt(np.where(seen, sizes, 1.0)), 0.0)
        root = axes * inverse[:, None, :]
        for a in range(k):
            roots[first + a, :k] = root[:, a] / scale[first + a, None]
    return roots, remaining, rank


def _products(candidates: CandidateColumns[Any], baseline: Baseline, rest: Array) -> Array:
    """Return Cᵀ·rest (m, B) for rows (R, B) that are orthogonal to the baseline."""
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
