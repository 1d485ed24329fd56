"""CasADi expressions as statements of plain C99, one sample at a time."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import casadi as ca

from lieid_casadi.errors import ExportError
from lieid_casadi.exporters.c.numbers import DOUBLE, Precision
from lieid_casadi.expressions.c_writer import UnsupportedOperation, statements
from lieid_casadi.expressions.model_functions import sparse_function

INDENT = "    "
ZEROS_PER_LINE = 5


@dataclass(frozen=True)
class FunctionInput:
    """A vector of symbols and the C expression of each of its elements."""

    symbol: ca.SX
    texts: tuple[str, ...]


def each(symbol: ca.SX, pattern: str) -> FunctionInput:
    """Return an input whose element j is a pattern with ``{j}`` filled in."""
    return FunctionInput(symbol, tuple(pattern.format(j=j) for j in range(symbol.size1())))


@dataclass(frozen=True)
class FunctionBody:
    """The body of a C function that writes a matrix, row after row.

    All inputs are read before the first result is written: they may be the same memory.
    """

    lines: tuple[str, ...]
    used: frozenset[str]
    operations: int

    @property
    def text(self) -> str:
        """The lines, indented."""
        return "\n".join(INDENT + line for line in self.lines)


def body(
    matrix: ca.SX,
    inputs: Mapping[str, FunctionInput],
    *,
    to: str,
    arguments: Sequence[str] = (),
    precision: Precision = DOUBLE,
) -> FunctionBody:
    """Return the C statements that evaluate a matrix.

    ``inputs``: local name → symbols; ``to``: the array (rows · columns) that takes the result;
    structural zeros are written too; ``arguments``: names of the C function's arguments; those that
    the inputs do not need are marked as unused; ``precision``: of all values.
    Raises `ExportError`: the expression has an operation without a C form, or a number that is not
    finite.
    """
    names = list(inputs)
    symbols = [given.symbol for given in inputs.values()]
    sparse = sparse_function("exported", symbols, [f"{name}_" for name in names], matrix)
    columns = matrix.shape[1]
    places = [int(i) * columns + int(j) for i, j in zip(sparse.rows, sparse.columns, strict=True)]

    def read(argument: int, j: int) -> tuple[str, str]:
        name = names[argument]
        return f"{name}_{j}", inputs[name].texts[j]

    def write(nonzero: int, value: str) -> str:
        return f"{to}[{places[nonzero]}] = {value};"

    try:
        written = statements(sparse.function, precision.dialect, read=read, write=write)
    except UnsupportedOperation as error:
        raise ExportError(
            f"an effect uses CasADi's operation {error.operation}, which exported C does not have; "
            "expected arithmetic, comparisons, powers, exponential, trigonometric and hyperbolic "
            "functions"
        ) from None
    by_joint = sorted(written.inputs, key=lambda x: (x.index, x.argument))
    loads = [f"{precision.dialect.declaration} {x.name} = {x.text};" for x in by_joint]
    read_names = set(re.findall(r"\w+", " ".join(x.text for x in by_joint)))
    unused = [f"(void){name};" for name in arguments if name not in read_names]
    zeros = _zeros(to, matrix.shape[0] * columns, places, precision)
    used = frozenset(names[x.argument] for x in written.inputs)
    return FunctionBody((*unused, *loads, *zeros, *written.lines), used, written.operations)


def _zeros(to: str, size: int, places: Sequence[int], precision: Precision) -> list[str]:
    """Return statements that write the structural zeros.

    Not as loops: compilers make `memset` or ``rep stos`` of them, which start so slowly that they
    take twice the time of computing a regressor.
    """
    zeros = sorted(set(range(size)) - set(places))
    return [
        "".join(f"{to}[{k}] = " for k in zeros[first : first + ZEROS_PER_LINE])
        + f"{precision.number(0.0)};"
        for first in range(0, len(zeros), ZEROS_PER_LINE)
    ]
