"""What each candidate would explain that the fitted model cannot: Frisch, Waugh, Lovell.

A column's part outside the span of the model's own columns is all that it can add; what the
rigid parameters can absorb is no evidence. With an orthonormal basis Q of the model's columns
neither the parts nor the refits have to be formed: gain = gᵀ·G⁻¹·g with g = Cᵀr and
G = CᵀC − (QᵀC)ᵀ(QᵀC).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import qr

from lieid_casadi.diagnosis.screening.candidate_columns import SMALLEST_SUPPORT, Bank

Array = NDArray[np.float64]
ABSORBED = 1e-6  # remaining part of a column below which no data can tell it
WEAK = 0.1  # remaining part below which a point of a shape grid says nothing of its own
RANK = 1e-9


@dataclass(frozen=True, eq=False)
class Baseline:
    """The model's own columns on all joints' whitened rows, and what they leave of the torque.

    Attributes
    ----------
    basis : (R, p)
        Orthonormal.
    residual : (R,)
        Whitened torque minus its projection.
    ends : (n + 1,) int
        Joint j has rows ends[j] to ends[j + 1].
    """

    basis: Array
    residual: Array
    ends: NDArray[np.intp]

    @classmethod
    def of(cls, matrices: Sequence[Array], torques: Sequence[Array]) -> Baseline:
        """Return the baseline of whitened columns (R_j, p) and torques (R_j,) per joint."""
        matrix = np.concatenate(matrices)
        scale = np.linalg.norm(matrix, axis=0)
        scale[scale == 0.0] = 1.0
        basis, triangle, _ = qr(matrix / scale, mode="economic", pivoting=True)
        sizes = np.abs(np.diag(triangle))
        basis = basis[:, sizes > RANK * sizes.max(initial=1e-300)]
        torque = np.concatenate(torques)
        ends = np.concatenate([[0], np.cumsum([len(t) for t in torques])]).astype(np.intp)
        return cls(basis, torque - basis @ (basis.T @ torque), ends)

    @property
    def rows(self) -> int:
        """Number of rows R."""
        return len(self.residual)

    def joint(self, j: int) -> slice:
        """Rows of joint j."""
        return slice(int(self.ends[j]), int(self.ends[j + 1]))

    def padded(self, columns: Array) -> Array:
        """Return columns (…, k) of the joints' rows on all rows (R, k): zero on others."""
        return np.pad(columns, ((0, self.rows - len(columns)), (0, 0)))

    def with_columns(self, columns: Array) -> Baseline:
        """Return the baseline with further columns (R, k) of a model."""
        columns = self.padded(columns)
        rest = columns - self.basis @ (self.basis.T @ columns)
        rest = rest - self.basis @ (self.basis.T @ rest)
        norms = np.linalg.norm(columns, axis=0)
        u, sizes, _ = np.linalg.svd(rest / np.where(norms > 0, norms, 1.0), full_matrices=False)
        new = u[:, sizes > ABSORBED]
        residual = self.residual - new @ (new.T @ self.residual)
        return Baseline(np.hstack([self.basis, new]), residual, self.ends)


@dataclass(frozen=True, eq=False)
class Screening:
    """Every group's gain beside a baseline.

    Attributes
    ----------
    gain : (G,)
        Fall of the whitened residual's sum of squares; 0 where a coefficient's sign is one
        that the physics rules out.
    remaining : (G,)
        Largest part of the group's columns, 0 to 1, that the baseline does not span.
    rank : (G,) int
        Number of directions that remain.
    whiteners : (m, k) and (m,) arrays
        See `statistic`.
    """

    bank: Bank[Any]
    baseline: Baseline
    gain: Array
    remaining: Array
    rank: NDArray[np.intp]
    _roots: Array
    _products: Array

    @cached_property
    def parameters(self) -> Array:
        """Numbers that each group adds to the model (G,)."""
        each = np.array([c.parameters for c in self.bank.candidates])
        return np.asarray(each[self.bank.candidate], dtype=float)

    def statistic(self, noise: Array) -> Array:
        """Return the gains (G, B) that white rows (R, B) would give."""
        rest = noise - self.baseline.basis @ (self.baseline.basis.T @ noise)
        products = _products(self.bank, self.baseline, rest)
        return _gains(self.bank, self._roots, products)


def screen(bank: Bank[Any], baseline: Baseline, *, every: bool = False) -> Screening:
    """Return every group's gain beside a baseline.

    ``every``: also of groups that rest on a few rows or on next to nothing of their own.
    """
    gram, norms = _grams(bank, baseline)
    roots, remaining, rank = _roots(bank, gram, norms)
    products = _products(bank, baseline, baseline.residual[:, None])
    gain = _gains(bank, roots, products)[:, 0]
    values = _values(bank, roots, products[:, 0])
    allowed = values >= bank.lower_bounds - 1e-12 if len(values) else np.zeros(0, bool)
    fine = np.logical_and.reduceat(allowed, bank.start) if len(values) else allowed
    fine &= bank.support >= SMALLEST_SUPPORT
    shaped = np.bincount(bank.candidate, minlength=len(bank.candidates))[bank.candidate] > 1
    fine &= ~(shaped & (remaining < WEAK))
    if every:
        fine[:] = True
    return Screening(
        bank, baseline, np.where(fine, gain, 0.0), remaining, rank, roots, products[:, 0]
    )


def _grams(bank: Bank[Any], baseline: Baseline) -> tuple[Array, Array]:
    """Return within-group products of what remains, by offset (k, m), and raw norms² (m,)."""
    projected = np.zeros((baseline.basis.shape[1], bank.count))
    for j, part in enumerate(bank.parts):
        projected[:, part.columns] += baseline.basis[baseline.joint(j)].T @ part.matrix
    inner = bank.inner.copy()
    norms = inner[0].copy()
    for offset in range(len(inner)):
        count = bank.count - offset
        inner[offset, :count] -= np.einsum("pc,pc->c", projected[:, :count], projected[:, offset:])
    return inner, norms


def _roots(bank: Bank[Any], gram: Array, norms: Array) -> tuple[Array, Array, NDArray[np.intp]]:
    """Return inverse square roots of the groups' Gram matrices as (m, k) rows, and what remains."""
    width = len(gram)
    roots = np.zeros((bank.count, width))
    remaining, rank = np.zeros(len(bank.size)), np.zeros(len(bank.size), dtype=np.intp)
    scale = np.sqrt(np.where(norms > 0.0, norms, 1.0))
    for k in np.unique(bank.size):
        groups = np.flatnonzero(bank.size == k)
        first = bank.start[groups]
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


def _products(bank: Bank[Any], baseline: Baseline, rest: Array) -> Array:
    """Return Cᵀ·rest (m, B) for rows (R, B) that are orthogonal to the baseline."""
    products = np.zeros((bank.count, rest.shape[1]))
    for j, part in enumerate(bank.parts):
        products[part.columns] += part.matrix.T @ rest[baseline.joint(j)]
    return products


def _gains(bank: Bank[Any], roots: Array, products: Array) -> Array:
    gains = np.zeros((len(bank.size), products.shape[1]))
    for direction in range(roots.shape[1]):
        along = np.add.reduceat(roots[:, direction, None] * products, bank.start, axis=0)
        gains += along**2
    return gains


def _values(bank: Bank[Any], roots: Array, products: Array) -> Array:
    """Return every group's least-squares coefficients (m,), each group alone."""
    values = np.zeros(bank.count)
    owner = np.repeat(np.arange(len(bank.size)), bank.size)
    for direction in range(roots.shape[1]):
        along = np.add.reduceat(roots[:, direction] * products, bank.start)
        values += roots[:, direction] * along[owner]
    return values
