"""CasADi expressions as statements of plain C99."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import casadi as ca

from lieid_casadi.errors import ExportError
from lieid_casadi.expressions.c_writer import ARITHMETIC, Dialect, UnsupportedOperation, statements
from lieid_casadi.expressions.model_functions import sparse_function

_CONDITIONS = {
    "LT": "{0} < {1} ? 1.0 : 0.0", "LE": "{0} <= {1} ? 1.0 : 0.0",
    "EQ": "{0} == {1} ? 1.0 : 0.0", "NE": "{0} != {1} ? 1.0 : 0.0",
    "NOT": "{0} == 0.0 ? 1.0 : 0.0",
    "AND": "{0} != 0.0 && {1} != 0.0 ? 1.0 : 0.0", "OR": "{0} != 0.0 || {1} != 0.0 ? 1.0 : 0.0",
    "IF_ELSE_ZERO": "{0} != 0.0 ? {1} : 0.0",
}  # fmt: skip
_LIBRARY = ("SIN", "COS", "EXP", "TANH", "SQRT", "FABS")  # all that is used of libm
_RUNTIME = (  # codegen/export/lieid_runtime.h
    "SIGN", "EXPM1", "LOG", "LOG1P", "TAN", "SINH", "COSH", "ASIN", "ACOS", "ATAN", "FLOOR",
    "CEIL",
)  # fmt: skip
_RUNTIME_OF_TWO = ("FMIN", "FMAX", "COPYSIGN", "ATAN2", "HYPOT")


TOLERANCE = 1e-12  # error that the self-test accepts, relative to the size of each result


def number(value: float) -> str:
    """Return a finite number as C reads it back, bit by bit."""
    if not math.isfinite(value):
        raise ExportError(f"the fit has a number that is {value}; expected finite ones")
    text = repr(float(value))
    return f"({text})" if text.startswith("-") else text


_FUNCTIONS = {name: f"{name.lower()}({{0}})" for name in _LIBRARY}
_FUNCTIONS |= {name: f"lieid_{name.lower()}({{0}})" for name in _RUNTIME}
_FUNCTIONS |= {name: f"lieid_{name.lower()}({{0}}, {{1}})" for name in _RUNTIME_OF_TWO}
DIALECT = Dialect("const double", ARITHMETIC | _CONDITIONS | _FUNCTIONS, number)
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
) -> FunctionBody:
    """Return the C statements that evaluate a matrix and write it, zeros too, to an array.

    ``inputs`` are the symbols by local name; ``arguments`` the names of the C function's
    arguments, of which those that the inputs do not need are marked as unused. An `ExportError`
    names an operation without a C form.
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
        written = statements(sparse.function, DIALECT, read=read, write=write)
    except UnsupportedOperation as error:
        raise ExportError(
            f"an effect uses CasADi's operation {error.operation}, which exported C does not have; "
            "expected arithmetic, comparisons, powers, exponential, trigonometric and hyperbolic "
            "functions"
        ) from None
    by_joint = sorted(written.inputs, key=lambda x: (x.index, x.argument))
    loads = [f"{DIALECT.declaration} {x.name} = {x.text};" for x in by_joint]
    read_names = set(re.findall(r"\w+", " ".join(x.text for x in by_joint)))
    unused = [f"(void){name};" for name in arguments if name not in read_names]
    zeros = _zeros(to, matrix.shape[0] * columns, places)
    used = frozenset(names[x.argument] for x in written.inputs)
    return FunctionBody((*unused, *loads, *zeros, *written.lines), used, written.operations)


def _zeros(to: str, size: int, places: Sequence[int]) -> list[str]:
    """Return statements that write the structural zeros.

    Not as loops: compilers make `memset` or ``rep stos`` of them, which start so slowly that they
    take twice the time of computing a regressor.
    """
    zeros = sorted(set(range(size)) - set(places))
    return [
        "".join(f"{to}[{k}] = " for k in zeros[first : first + ZEROS_PER_LINE]) + "0.0;"
        for first in range(0, len(zeros), ZEROS_PER_LINE)
    ]
