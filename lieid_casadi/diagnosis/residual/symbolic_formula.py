"""A short formula for the unexplained residual: sparse regression over a small dictionary."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lieid_casadi.diagnosis.options import DiagnosisOptions
from lieid_casadi.diagnosis.residual.function_dictionary import Term, dictionaries
from lieid_casadi.diagnosis.residual.projected_residual import ProjectedResidual
from lieid_casadi.diagnosis.residual.unexplained import Unexplained
from lieid_casadi.diagnosis.screening.cross_validation import cross_validated_gain

Array = NDArray[np.float64]
Indices = NDArray[np.intp]
PARALLEL = 1e-3  # 1 − r² below which two columns are the same
PAIRS = 40  # best pairs to which a third term is added
EXCHANGES = 5  # rounds in which a term of a triple is replaced


@dataclass(frozen=True)
class Formula:
    """A sum of few simple terms that explains most of what smooth functions explain.

    Attributes
    ----------
    terms : tuple of Term
    values, std : tuple of float
        Coefficients and their standard deviations.
    units : tuple of str
        Of the coefficients.
    part : float
        Held-out gain relative to that of the smooth functions.
    """

    terms: tuple[Term, ...]
    values: tuple[float, ...]
    std: tuple[float, ...]
    units: tuple[str, ...]
    part: float

    @property
    def text(self) -> str:
        """Such as ``0.31·sin(2 q3)·dq1 + 0.02·dq1²`` (N·m)."""
        text = ""
        for value, term in zip(self.values, self.terms, strict=True):
            sign = "−" if value < 0.0 else "+"
            text += f" {sign} {abs(value):.3g}·{term.text}"
        return text[3:] if text.startswith(" +") else "−" + text[3:]

    def to_dict(self) -> dict[str, Any]:
        """Return it for JSON."""
        rows = zip(self.terms, self.values, self.std, self.units, strict=True)
        return {
            "text": self.text,
            "part": self.part,
            "terms": [
                {"term": term.text, "value": value, "std": std, "unit": unit}
                for term, value, std, unit in rows
            ],
        }


def find_formula(part: Unexplained, residual: ProjectedResidual) -> Formula | None:
    """Return a formula of at most three terms of a part's signals, or None.

    On held-out blocks of time it must explain most of what the smooth functions explain.
    """
    options = residual.options
    own = residual.baseline.residual[residual.baseline.joint(part.joint)]
    smooth = part.fraction * float(np.sum(own**2))
    names = [name for name in part.depends_on if name != "t"]
    found = [
        _sparse(part.joint, terms, smooth, residual)
        for terms in (dictionaries(names, residual.revolute) if names else ())
    ]
    # of two that explain as much, the one with fewer terms
    price = options.least_term_part * smooth
    best = max(found, key=lambda f: f[0] - price * len(f[1]), default=(0.0, [], None))
    explained, kept, columns = best
    if columns is None or explained < options.least_formula_part * smooth:
        return None
    estimate = residual.fit(columns)
    order = np.argsort(-np.abs(estimate.values) * np.linalg.norm(columns, axis=0))
    return Formula(
        tuple(kept[k] for k in order),
        tuple(float(v) for v in estimate.values[order]),
        tuple(float(v) for v in estimate.std[order]),
        tuple(kept[k].unit(residual.revolute, part.joint) for k in order),
        explained / smooth,
    )


def _sparse(
    joint: int, terms: Sequence[Term], smooth: float, residual: ProjectedResidual
) -> tuple[float, list[Term], Array | None]:
    """Return the held-out gain of the best few terms, these terms, and their columns (R, k)."""
    baseline, options = residual.baseline, residual.options
    along = [np.column_stack([t.along(s) for t in terms]) for s in residual.signals]
    columns = residual.columns(joint, along)
    rest, usable = _normalized(columns, residual)
    best: tuple[float, list[Term], Array | None] = (0.0, [], None)
    if not len(usable):
        return best
    costs = np.array([terms[k].cost for k in usable])
    for subset in best_subsets(rest, baseline.residual, costs, options):
        own = columns[:, usable[subset]]
        gain = cross_validated_gain(own, baseline, residual.folds)
        if gain < best[0] + options.least_term_part * smooth:
            break
        best = gain, [terms[k] for k in usable[subset]], own
    return best


def _normalized(columns: Array, residual: ProjectedResidual) -> tuple[Array, Indices]:
    """Return the projected columns with unit length (R, u), and the indices of those used (u,)."""
    rest = residual.baseline.outside(columns)
    size, left = np.linalg.norm(columns, axis=0), np.linalg.norm(rest, axis=0)
    least = residual.options.least_term_own_part
    usable = np.flatnonzero(left > least * np.maximum(size, 1e-300))
    return rest[:, usable] / left[usable], usable


def best_subsets(
    rest: Array, residual: Array, costs: Array, options: DiagnosisOptions
) -> list[Indices]:
    """Return the best subset of one, of two and of three columns.

    Parameters
    ----------
    rest : (R, u)
        Columns of unit length.
    residual : (R,)
    costs : (u,)
        Complexity of each column.
    options : DiagnosisOptions

    Returns
    -------
    list of int arrays
        Of lengths one, two and three; fewer where there are fewer columns.
    """
    gram, products = rest.T @ rest, rest.T @ residual
    total = float(np.max(products**2))
    price = options.term_cost * total * costs
    subsets = [np.array([int(np.argmax(products**2 - price))], dtype=np.intp)]
    one, two = np.triu_indices(len(costs), 1)
    pairs = (_pair_gains(gram, products) - price[:, None] - price[None, :])[one, two]
    best = np.argsort(-pairs)[: min(PAIRS, int(np.isfinite(pairs).sum()))]
    first = [np.array([one[k], two[k]], dtype=np.intp) for k in best]
    subsets += first[:1]
    if not first or len(costs) < 3:
        return subsets
    scored = [_with_third(gram, products, price, pair) for pair in first]
    score, triple = max(scored, key=lambda found: found[0])
    if not np.isfinite(score):
        return subsets
    for _ in range(EXCHANGES):  # exchange one term, keeping the two others
        again = max(
            (_with_third(gram, products, price, np.delete(triple, k)) for k in range(3)),
            key=lambda found: found[0],
        )[1]
        if set(again) == set(triple):
            break
        triple = again
    return [*subsets, triple]


def _pair_gains(gram: Array, products: Array) -> Array:
    """Return the gain (u, u) of every pair of columns; −inf where two are the same."""
    apart = 1.0 - gram**2
    a, b = products[:, None], products[None, :]
    gain = (a**2 + b**2 - 2.0 * a * b * gram) / np.maximum(apart, PARALLEL)
    return np.where(apart > PARALLEL, gain, -np.inf)


def _with_third(gram: Array, products: Array, price: Array, pair: Indices) -> tuple[float, Indices]:
    """Return the score of two columns (2,) with the best third one, and the three (3,)."""
    inverse = np.linalg.inv(gram[np.ix_(pair, pair)])
    values = inverse @ products[pair]
    apart = 1.0 - np.einsum("ku,kl,lu->u", gram[pair], inverse, gram[pair])
    gain = (products - gram[:, pair] @ values) ** 2 / np.maximum(apart, PARALLEL)
    score = np.where(apart > PARALLEL, gain - price, -np.inf)
    third = int(np.argmax(score))
    own = float(products[pair] @ values - price[pair].sum())
    return own + float(score[third]), np.array([*pair, third], dtype=np.intp)
