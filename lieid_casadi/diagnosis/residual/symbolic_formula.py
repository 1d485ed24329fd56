"""A short formula for what stays unexplained: sparse regression over a small dictionary."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lieid_casadi.diagnosis.residual.function_dictionary import Term, dictionaries
from lieid_casadi.diagnosis.residual.projected_residual import Remainder
from lieid_casadi.diagnosis.residual.unexplained import Unexplained
from lieid_casadi.diagnosis.search.rivals import cross_validated_gain

Array = NDArray[np.float64]
Indices = NDArray[np.intp]
MOST_TERMS = 3
ENOUGH = 0.8  # of what the smooth functions explain of held-out blocks
ADDS = 0.03  # of that: a further term that brings less is not taken
PRICE = 0.002  # of the gain, for each step of a term's cost: the simpler of two equals is taken
REMAINS = 0.05  # part of a column that the model's own must leave
APART = 1e-3  # 1 − r² below which two columns are the same
PAIRS, TRIPLES = 40, 5  # best pairs that a third term is tried on; exchanges afterwards


@dataclass(frozen=True)
class Form:
    """A sum of few simple terms that explains most of what smooth functions do.

    Attributes
    ----------
    terms : tuple of Term
    values, std : tuple of float
        Coefficients and their standard deviations.
    units : tuple of str
    part : float
        Of what the smooth functions explain of held-out blocks.
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


def form_of(part: Unexplained, remainder: Remainder) -> Form | None:
    """Return a formula of at most three terms of the named signals, or None.

    It must explain, of blocks of time held out, four fifths of what the smooth functions do.
    """
    own = remainder.baseline.residual[remainder.baseline.joint(part.joint)]
    smooth = part.fraction * float(np.sum(own**2))
    names = [name for name in part.depends_on if name != "t"]
    found = [
        _sparse(part.joint, terms, smooth, remainder)
        for terms in (dictionaries(names, remainder.revolute) if names else ())
    ]
    # of two that explain as much, the one with fewer terms
    best = max(found, key=lambda f: f[0] - ADDS * smooth * len(f[1]), default=(0.0, [], None))
    explained, kept, columns = best
    if columns is None or explained < ENOUGH * smooth:
        return None
    estimate = remainder.fit(columns)
    order = np.argsort(-np.abs(estimate.values) * np.linalg.norm(columns, axis=0))
    return Form(
        tuple(kept[k] for k in order),
        tuple(float(v) for v in estimate.values[order]),
        tuple(float(v) for v in estimate.std[order]),
        tuple(kept[k].unit(remainder.revolute, part.joint) for k in order),
        explained / smooth,
    )


def _sparse(
    joint: int, terms: Sequence[Term], smooth: float, remainder: Remainder
) -> tuple[float, list[Term], Array | None]:
    """Return what the best few terms explain of held-out blocks, those terms, their columns."""
    baseline = remainder.baseline
    along = [np.column_stack([t.along(s) for t in terms]) for s in remainder.signals]
    columns = remainder.columns(joint, along)
    rest, usable = _normalized(columns, remainder)
    best: tuple[float, list[Term], Array | None] = (0.0, [], None)
    if not len(usable):
        return best
    costs = np.array([terms[k].cost for k in usable])
    for subset in _subsets(rest, baseline.residual, costs):
        own = columns[:, usable[subset]]
        gain = cross_validated_gain(own, baseline, remainder.folds)
        if gain < best[0] + ADDS * smooth:
            break
        best = gain, [terms[k] for k in usable[subset]], own
    return best


def _normalized(columns: Array, remainder: Remainder) -> tuple[Array, Indices]:
    """Return what the model leaves of columns, of length one (R, u), and which have enough."""
    rest = remainder.beside_model(columns)
    size, left = np.linalg.norm(columns, axis=0), np.linalg.norm(rest, axis=0)
    usable = np.flatnonzero(left > REMAINS * np.maximum(size, 1e-300))
    return rest[:, usable] / left[usable], usable


def _subsets(rest: Array, residual: Array, costs: Array) -> list[Indices]:
    """Return the best subsets of one, two and three columns of length one."""
    gram, products = rest.T @ rest, rest.T @ residual
    total = float(np.max(products**2))
    price = PRICE * total * costs
    subsets = [np.array([int(np.argmax(products**2 - price))], dtype=np.intp)]
    one, two = np.triu_indices(len(costs), 1)
    pairs = (_pair_gains(gram, products) - price[:, None] - price[None, :])[one, two]
    best = np.argsort(-pairs)[: min(PAIRS, int(np.isfinite(pairs).sum()))]
    first = [np.array([one[k], two[k]], dtype=np.intp) for k in best]
    subsets += first[:1]
    if not first or len(costs) < MOST_TERMS:
        return subsets
    scored = [_with_third(gram, products, price, pair) for pair in first]
    score, triple = max(scored, key=lambda found: found[0])
    if not np.isfinite(score):
        return subsets
    for _ in range(TRIPLES):  # exchange one term beside the two others
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
    gain = (a**2 + b**2 - 2.0 * a * b * gram) / np.maximum(apart, APART)
    return np.where(apart > APART, gain, -np.inf)


def _with_third(gram: Array, products: Array, price: Array, pair: Indices) -> tuple[float, Indices]:
    """Return the best third column beside two others, and the score of the three."""
    inverse = np.linalg.inv(gram[np.ix_(pair, pair)])
    values = inverse @ products[pair]
    apart = 1.0 - np.einsum("ku,kl,lu->u", gram[pair], inverse, gram[pair])
    gain = (products - gram[:, pair] @ values) ** 2 / np.maximum(apart, APART)
    score = np.where(apart > APART, gain - price, -np.inf)
    third = int(np.argmax(score))
    own = float(products[pair] @ values - price[pair].sum())
    return own + float(score[third]), np.array([*pair, third], dtype=np.intp)
