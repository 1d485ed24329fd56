"""Span and null space of matrices whose entries are floats and polynomials in lengths."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from lieid_casadi.dynamics.laurent import Laurent, quotient, reciprocal

Entries = NDArray[Any]
TOLERANCE = 1e-9  # of the coefficients of an entry: those of geometry are of size 1


def cleaned(values: Entries) -> Entries:
    """Return entries without coefficients that are rounding, next to halves if they are near."""
    made = np.empty(values.shape, dtype=object)
    for index, entry in np.ndenumerate(values):
        made[index] = _cleaned(entry)
    return made


def _cleaned(entry: Any) -> Any:
    if not isinstance(entry, Laurent):
        half = round(2.0 * entry) / 2.0
        return half if abs(entry - half) < TOLERANCE else float(entry)
    terms = {powers: _cleaned(value) for powers, value in entry.terms.items()}
    return Laurent({p: v for p, v in terms.items() if v}) + 0.0


def eliminated(rows: Entries, order: list[int] | None = None) -> tuple[Entries, list[int]]:
    """Return the reduced echelon form of rows (r, k) and the pivots' columns (r,).

    ``rows`` (m, k); ``order``: columns in the order in which pivots are sought; any pivot of one
    term if left out.
    """
    rest: list[Entries] = list(cleaned(rows))
    done: list[Entries] = []
    pivots: list[int] = []
    while rest:
        row, column, top = _pivot(rest, order, pivots)
        if top is None:
            break
        others = [cleaned(x - top * x[column]) for k, x in enumerate(rest) if k != row]
        done = [cleaned(x - top * x[column]) for x in done] + [top]
        rest = [x for x in others if x.any()]
        pivots.append(column)
    return np.array(done, dtype=object).reshape(-1, rows.shape[1]), pivots


def _pivot(
    rest: list[Entries], order: list[int] | None, pivots: list[int]
) -> tuple[int, int, Entries | None]:
    """Return row and column of a pivot, and that row divided by it; None if there is none.

    The simplest entry is chosen, the largest of several; with ``order`` in the first column that
    has any. An entry of several terms is a pivot if it divides all of its row.

    Raises `ModelError`: there are entries, but none divides its row.
    """
    groups = [list(range(len(rest[0])))] if order is None else [[column] for column in order]
    for group in groups:
        entries = [
            (-len(entry.terms) if isinstance(entry, Laurent) else 0, abs(entry), row, column)
            for column in group
            if column not in pivots
            for row, entry in enumerate(x[column] for x in rest)
            if entry
        ]
        for _, _, row, column in sorted(entries, reverse=True):
            divided = _divided(rest[row], rest[row][column])
            if divided is not None:
                return row, column, divided
        if entries:
            reciprocal(rest[entries[0][2]][entries[0][3]])  # raises
    return -1, -1, None


def _divided(row: Entries, pivot: Any) -> Entries | None:
    made = np.empty(row.shape, dtype=object)
    for k, entry in enumerate(row):
        made[k] = quotient(entry, pivot)
        if made[k] is None:
            return None
    return cleaned(made)


def span(rows: Entries) -> Entries:
    """Return a basis of the rows' span."""
    return eliminated(rows)[0]


def null(rows: Entries) -> Entries:
    """Return a basis (d, k) of the vectors that all rows (m, k) map to zero."""
    reduced, pivots = eliminated(rows)
    free = [k for k in range(rows.shape[1]) if k not in pivots]
    basis = np.zeros((len(free), rows.shape[1])).astype(object)
    for position, column in enumerate(free):
        basis[position, column] = 1.0
        for row, pivot in enumerate(pivots):
            basis[position, pivot] = -reduced[row, column]
    return basis
