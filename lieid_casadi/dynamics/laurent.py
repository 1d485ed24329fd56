"""Polynomials in lengths, cosines and sines, and elimination with them, for base parameters.

Entries of the algorithm of `lieid_casadi.dynamics.null_space` are floats or `Laurent` polynomials
(with negative powers), in arrays of dtype object. Results without a length are floats again, so
that most of the arithmetic is plain.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from lieid_casadi.errors import ModelError

Powers = tuple[tuple[str, int], ...]  # (name, exponent) in order of names
ROUNDING = 1e-11  # of a coefficient: products of entries of rotations, below 1 in size
COSINE, SINE = "cos(", "sin("  # beginnings of names of symbols
LONGEST = 20  # terms of a quotient
SUPERSCRIPTS = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")


class Laurent:
    """A sum of coefficients times products of powers of lengths.

    ``terms``: powers → coefficient.
    """

    __slots__ = ("terms",)

    def __init__(self, terms: Mapping[Powers, float]) -> None:
        self.terms = dict(terms)

    @classmethod
    def symbol(cls, name: str) -> Laurent:
        """Return a length."""
        return cls({((name, 1),): 1.0})

    @property
    def monomial(self) -> bool:
        """Whether there is one term."""
        return len(self.terms) == 1

    def __add__(self, other: Any) -> Any:
        terms = dict(self.terms)
        for powers, value in _terms(other).items():
            terms[powers] = terms.get(powers, 0.0) + value
        return _normal(terms)

    def __mul__(self, other: Any) -> Any:
        terms: dict[Powers, float] = {}
        for a, x in self.terms.items():
            for b, y in _terms(other).items():
                powers = _product(a, b)
                terms[powers] = terms.get(powers, 0.0) + x * y
        return _normal(terms)

    def __truediv__(self, other: Any) -> Any:
        return self * reciprocal(other)

    def __rtruediv__(self, other: Any) -> Any:
        return reciprocal(self) * other

    def __neg__(self) -> Laurent:
        return Laurent({powers: -value for powers, value in self.terms.items()})

    def __sub__(self, other: Any) -> Any:
        return self + -other

    def __rsub__(self, other: Any) -> Any:
        return -self + other

    __radd__ = __add__
    __rmul__ = __mul__

    def __abs__(self) -> float:
        """Return the largest coefficient in size."""
        return max(abs(value) for value in self.terms.values())

    def at(self, values: Mapping[str, Any]) -> Any:
        """Return the value for given lengths, numbers or SX."""
        total = 0.0
        for powers, value in self.terms.items():
            for name, exponent in powers:
                value = value * _value(name, values) ** exponent
            total = total + value
        return total

    def text(self, *, digits: int = 6) -> tuple[str, str]:
        """Return the sign of the first term, and the polynomial without it: ``-``, ``2 d3²``."""
        ordered = sorted(self.terms.items())
        negative = ordered[0][1] < 0
        words = []
        for powers, value in ordered:
            size = f"{abs(value):.{digits}g}"
            letters = [
                name + (str(e).translate(SUPERSCRIPTS) if e != 1 else "") for name, e in powers
            ]
            factors = letters if size == "1" and letters else [size, *letters]
            sign = "+" if (value < 0) == negative else "-"
            words.append(f"{sign} {' '.join(factors)}")
        joined = " ".join(words).removeprefix("+ ")
        return "-" if negative else "+", joined if self.monomial else f"({joined})"


def reciprocal(value: Any) -> Any:
    """Return 1/value of a number or of a polynomial of one term.

    Raises `ModelError`: a polynomial of several terms, whose reciprocal is none.
    """
    if not isinstance(value, Laurent):
        return 1.0 / value
    if not value.monomial:
        raise ModelError(
            f"base parameters: division by {value.text()[1]}, which has several terms; expected "
            "geometry whose base parameters are polynomials, such as one symbol in place of a sum"
        )
    ((powers, coefficient),) = value.terms.items()
    return Laurent({tuple((name, -e) for name, e in powers): 1.0 / coefficient})


def quotient(value: Any, divisor: Any) -> Any:
    """Return value/divisor if it is a polynomial, else None: division by leading terms."""
    if not isinstance(divisor, Laurent) or divisor.monomial:
        return value * reciprocal(divisor)
    names = sorted({name for each in (value, divisor) for p in _terms(each) for name, _ in p})

    def leading(x: Any) -> Laurent:
        """Return the term that comes last by the exponents in the order of names."""
        last = max(_terms(x), key=lambda powers: [dict(powers).get(name, 0) for name in names])
        return Laurent({last: _terms(x)[last]})

    inverse = reciprocal(leading(divisor))
    rest, result = value, 0.0
    for _ in range(LONGEST):
        if not rest:
            return result
        term = leading(rest) * inverse
        result, rest = result + term, rest - term * divisor
    return None


def _terms(value: Any) -> dict[Powers, float]:
    if isinstance(value, Laurent):
        return value.terms
    return {(): float(value)} if value else {}


def _product(a: Powers, b: Powers) -> Powers:
    if not a or not b:
        return a or b
    exponents = dict(a)
    for name, exponent in b:
        exponents[name] = exponents.get(name, 0) + exponent
    return tuple(sorted((name, e) for name, e in exponents.items() if e))


def _normal(terms: dict[Powers, float]) -> Any:
    """Return a polynomial without terms that are rounding; a float without lengths.

    With sin² = 1 − cos² there is one way to write a polynomial.
    """
    kept = {powers: value for powers, value in terms.items() if abs(value) > ROUNDING}
    if not kept:
        return 0.0
    if kept.keys() == {()}:
        return kept[()]
    square = next(
        ((p, name) for p in kept for name, e in p if e >= 2 and name.startswith(SINE)), None
    )
    if square is None:
        return Laurent(kept)
    powers, name = square
    rest = Laurent({_product(powers, ((name, -2),)): kept.pop(powers)})
    cosine = Laurent.symbol(COSINE + name.removeprefix(SINE))
    return rest * (1.0 - cosine * cosine) + _normal(kept)


def _value(name: str, values: Mapping[str, Any]) -> Any:
    """Return the value of a symbol, or of the cosine or sine of one."""
    for prefix, function in ((COSINE, ca.cos), (SINE, ca.sin)):
        if name.startswith(prefix):
            return function(values[name.removeprefix(prefix).removesuffix(")")])
    return values[name]


def polynomial(expression: ca.SX) -> Any:
    """Return an SX expression as a polynomial in its symbols.

    Raises `ModelError`: it has other operations than sums, products, and the cosine and sine of a
    symbol.
    """
    symbols = ca.symvar(expression)
    function = ca.Function("entry", [ca.vertcat(*symbols)], [expression])
    work: dict[int, Any] = {}
    for k in range(function.n_instructions()):
        operation, to = function.instruction_id(k), function.instruction_output(k)
        given = function.instruction_input(k)
        if operation == ca.OP_OUTPUT:
            return work[given[0]]
        if operation == ca.OP_INPUT:
            work[to[0]] = Laurent.symbol(str(symbols[given[1]]))
        elif operation == ca.OP_CONST:
            work[to[0]] = float(function.instruction_constant(k))
        elif operation in (ca.OP_COS, ca.OP_SIN) and _is_symbol(work[given[0]]):
            prefix = COSINE if operation == ca.OP_COS else SINE
            work[to[0]] = Laurent.symbol(f"{prefix}{work[given[0]].text()[1]})")
        elif operation in _ARITHMETIC:
            work[to[0]] = _ARITHMETIC[operation](*(work[x] for x in given))
        else:
            raise ModelError(
                f"base parameters: the geometry has {expression}; expected sums and products of "
                "lengths, and of cosines and sines of single symbols"
            )
    return 0.0


def _is_symbol(value: Any) -> bool:
    return isinstance(value, Laurent) and list(value.terms) == [((value.text()[1], 1),)]


_ARITHMETIC: dict[int, Any] = {
    ca.OP_ADD: lambda a, b: a + b,
    ca.OP_SUB: lambda a, b: a - b,
    ca.OP_MUL: lambda a, b: a * b,
    ca.OP_DIV: lambda a, b: a * reciprocal(b),
    ca.OP_NEG: lambda a: -a,
    ca.OP_SQ: lambda a: a * a,
    ca.OP_TWICE: lambda a: 2.0 * a,
    ca.OP_INV: reciprocal,
    ca.OP_ASSIGN: lambda a: a,
}


def polynomials(array: NDArray[Any], *, snap: float) -> NDArray[Any]:
    """Return numbers and SX expressions as floats and polynomials.

    ``array`` (…): dtype float or object; ``snap``: numbers that differ from a whole number by less
    are that number.
    """
    made = np.empty(array.shape, dtype=object)
    for index, entry in np.ndenumerate(array):
        if isinstance(entry, ca.SX):
            made[index] = polynomial(entry)
        else:
            whole = float(np.round(entry))
            made[index] = whole if abs(entry - whole) < snap else float(entry)
    return made


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
