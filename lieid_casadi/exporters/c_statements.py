"""CasADi expressions as statements of plain C99, one sample at a time."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache

import casadi as ca

from lieid_casadi.errors import ExportError

_PATTERNS = {
    "ASSIGN": "{0}", "ADD": "{0} + {1}", "SUB": "{0} - {1}", "MUL": "{0} * {1}", "DIV": "{0} / {1}",
    "NEG": "-{0}", "SQ": "{0} * {0}", "TWICE": "{0} + {0}", "INV": "1.0 / {0}",
    "POW": "lieid_pow({0}, {1})", "CONSTPOW": "lieid_pow({0}, {1})",
    "LT": "{0} < {1} ? 1.0 : 0.0", "LE": "{0} <= {1} ? 1.0 : 0.0",
    "EQ": "{0} == {1} ? 1.0 : 0.0", "NE": "{0} != {1} ? 1.0 : 0.0",
    "NOT": "{0} == 0.0 ? 1.0 : 0.0",
    "AND": "{0} != 0.0 && {1} != 0.0 ? 1.0 : 0.0", "OR": "{0} != 0.0 || {1} != 0.0 ? 1.0 : 0.0",
    "IF_ELSE_ZERO": "{0} != 0.0 ? {1} : 0.0",
}  # fmt: skip
_LIBRARY = ("SIN", "COS", "EXP", "TANH", "SQRT", "FABS")  # all that is used of libm
_RUNTIME = (  # codegen/export/lieid_runtime.h
    "SIGN", "FMIN", "FMAX", "COPYSIGN", "EXPM1", "LOG", "LOG1P", "TAN", "SINH", "COSH", "ASIN",
    "ACOS", "ATAN", "ATAN2", "HYPOT", "FLOOR", "CEIL",
)  # fmt: skip
INDENT = "    "
ZEROS_PER_LINE = 5


@dataclass(frozen=True)
class Input:
    """A vector of symbols and the C expression of each of its elements."""

    symbol: ca.SX
    texts: tuple[str, ...]


def each(symbol: ca.SX, pattern: str) -> Input:
    """Return an input whose element j is a pattern with ``{j}`` filled in."""
    return Input(symbol, tuple(pattern.format(j=j) for j in range(symbol.size1())))


@dataclass(frozen=True)
class Body:
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


def body(matrix: ca.SX, inputs: Mapping[str, Input], *, to: str) -> Body:
    """Return the C statements that evaluate a matrix.

    Parameters
    ----------
    inputs : mapping
        Local name → symbols.
    to : str
        The array (rows · columns) that takes the result; structural zeros are written too.

    Raises
    ------
    ExportError
        The expression has an operation without a C form, or a number that is not finite.
    """
    function, places = _function(matrix, inputs)
    names = list(inputs)
    loads: list[str] = []
    lines: list[str] = []
    used: set[str] = set()
    value: dict[int, str] = {}  # CasADi's work vector: what each slot holds now
    pending: dict[int, tuple[int, int]] = {}  # inputs not used so far
    operations = 0
    for i in range(function.n_instructions()):
        operation = _operation_names()[function.instruction_id(i)]
        target, source = function.instruction_output(i), function.instruction_input(i)
        if operation == "INPUT":
            pending[target[0]] = (source[0], source[1])
            value[target[0]] = f"{names[source[0]]}_{source[1]}"
            continue
        if operation == "CONST":
            pending.pop(target[0], None)
            value[target[0]] = number(function.instruction_constant(i))
            continue
        for slot in source:
            if slot in pending:
                argument, j = pending.pop(slot)
                name = names[argument]
                loads.append(f"const double {name}_{j} = {inputs[name].texts[j]};")
                used.add(name)
        if operation == "OUTPUT":
            lines.append(f"{to}[{places[target[1]]}] = {value[source[0]]};")
            continue
        text = _expression(operation, [value[k] for k in source])
        lines.append(f"const double t{i} = {text};")
        pending.pop(target[0], None)
        value[target[0]] = f"t{i}"
        operations += 1
    zeros = _zeros(to, matrix.shape[0] * matrix.shape[1], places)
    return Body((*dict.fromkeys(loads), *zeros, *lines), frozenset(used), operations)


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


def _function(matrix: ca.SX, inputs: Mapping[str, Input]) -> tuple[ca.Function, list[int]]:
    """Return a function of the matrix's nonzeros, and their places row after row."""
    matrix = ca.sparsify(matrix)
    rows, columns = matrix.sparsity().get_triplet()
    places = [int(i) * matrix.shape[1] + int(j) for i, j in zip(rows, columns, strict=True)]
    symbols = [given.symbol for given in inputs.values()]
    names = [f"{name}_" for name in inputs]  # CasADi reserves some names
    nonzeros = ca.densify(ca.vec(matrix.nz[:]))
    return ca.Function("exported", symbols, [nonzeros], names, ["r"], {"cse": True}), places


def _expression(operation: str, operands: list[str]) -> str:
    if operation in _PATTERNS:
        return _PATTERNS[operation].format(*operands)
    arguments = ", ".join(operands)
    if operation in _LIBRARY:
        return f"{operation.lower()}({arguments})"
    if operation in _RUNTIME:
        return f"lieid_{operation.lower()}({arguments})"
    raise ExportError(
        f"an effect uses CasADi's operation {operation}, which exported C does not have; expected "
        "arithmetic, comparisons, powers, exponential, trigonometric and hyperbolic functions"
    )


@cache
def _operation_names() -> dict[int, str]:
    return {getattr(ca, name): name[3:] for name in dir(ca) if name.startswith("OP_")}


def number(value: float) -> str:
    """Return a double as C reads it back, bit by bit.

    Raises
    ------
    ExportError
        It is infinite or NaN.
    """
    if not math.isfinite(value):
        raise ExportError(f"the fit has a number that is {value}; expected finite ones")
    text = repr(float(value))
    return f"({text})" if text.startswith("-") else text
