"""C source of an expression: straight-line code on vectors of samples.

CasADi eliminates common subexpressions and orders the work; its list of instructions becomes one
C statement each, on the type `lieid_v` of ``codegen/lieid_lanes.h``. The same text serves every
number of lanes, one included.
"""

from __future__ import annotations

import math
from functools import cache

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from lieid_casadi.errors import CompilerError
from lieid_casadi.expressions.model_functions import SparseFunction

Indices = NDArray[np.intp]

# Arguments that are the same for every sample; all others come per sample.
CONSTANT_ARGUMENTS = frozenset({"parameters", "coefficients", "shapes", "dead_zone"})

_INFIX = {"ADD": "+", "SUB": "-", "MUL": "*", "DIV": "/"}
_PATTERNS = {
    "ASSIGN": "{0}", "NEG": "-{0}", "SQ": "{0} * {0}", "TWICE": "{0} + {0}", "INV": "1.0 / {0}",
    "CONSTPOW": "lieid_pow({0}, {1})",
}  # fmt: skip
_MACROS = ("LT", "LE", "EQ", "NE", "NOT", "AND", "OR", "IF_ELSE_ZERO")
_FUNCTIONS = (
    "SQRT", "FABS", "SIGN", "FMIN", "FMAX", "EXP", "SIN", "COS", "TAN", "ASIN", "ACOS", "ATAN",
    "SINH", "COSH", "TANH", "LOG", "LOG1P", "EXPM1", "ERF", "FLOOR", "CEIL", "POW", "ATAN2", "FMOD",
    "HYPOT", "COPYSIGN",
)  # fmt: skip


class UnsupportedOperation(CompilerError):
    """An expression uses a function that the C side does not have."""


def kernel_source(sparse: SparseFunction) -> str:
    """Return the C source of a kernel that evaluates a sparse matrix on LIEID_LANES samples.

    The kernel ``void lieid_kernel(in, rows, ld)`` reads value j of argument a at
    ``in[a] + j * LIEID_LANES`` (constants at ``in[a][j]``), and writes the k-th nonzero of
    matrix row i, columns ascending, to ``rows[i] + k * ld``. Further symbols tell the shape, the
    place of each nonzero (row after row) and the arguments with their widths, 0 where unused.

    Raises
    ------
    UnsupportedOperation
        An operation of the expression has no C form here.
    """
    function = sparse.function
    names = [str(function.name_in(k)) for k in range(function.n_in())]
    order = np.lexsort((sparse.columns, sparse.rows))
    lines, used = _statements(sparse, names, order)
    statements = "\n".join(lines)
    if {"sin", "cos"} & used:
        used.add("q")  # the runtime takes them from it
    arguments = " ".join(
        f"{name}:{int(function.size1_in(k)) if name in used else 0}" for k, name in enumerate(names)
    )
    return (
        '#include "lieid_lanes.h"\n'
        f"const int32_t lieid_shape[3] = {{{sparse.shape[0]}, {sparse.shape[1]}, {len(order)}}};\n"
        f'const char lieid_arguments[] = "{arguments}";\n'
        f"const int32_t lieid_rows[] = {{{_numbers(sparse.rows[order])}}};\n"
        f"const int32_t lieid_columns[] = {{{_numbers(sparse.columns[order])}}};\n"
        "void lieid_kernel(const double *const *restrict in, double *const *restrict rows,"
        " ptrdiff_t ld)\n"
        f"{{\n    (void)in, (void)rows, (void)ld;\n{statements}\n}}\n"
    )


def _statements(
    sparse: SparseFunction, names: list[str], order: Indices
) -> tuple[list[str], set[str]]:
    """Return the statements, and the names of the arguments that they use."""
    function, lines, used = sparse.function, [], set()
    value: dict[int, str] = {}  # CasADi's work vector: what each slot holds now
    pending: dict[int, tuple[str, str]] = {}  # inputs not used so far: name, statement
    places = _places(sparse, order)
    for i in range(function.n_instructions()):
        operation = _operation_names()[function.instruction_id(i)]
        target, source = function.instruction_output(i), function.instruction_input(i)
        if operation == "INPUT":
            argument, j = source
            text = _input(argument, j, constant=names[argument] in CONSTANT_ARGUMENTS)
            pending[target[0]] = names[argument], f"    const lieid_v t{i} = {text};"
            value[target[0]] = f"t{i}"
            continue
        if operation == "CONST":
            value[target[0]] = f"lieid_splat({_number(function.instruction_constant(i))})"
            continue
        for slot in source:
            if slot in pending:
                name, line = pending.pop(slot)
                used.add(name)
                lines.append(line)
        if operation == "OUTPUT":
            row, k = places[target[1]]
            lines.append(f"    lieid_store(rows[{row}] + {k} * ld, {value[source[0]]});")
            continue
        text = _expression(operation, [value[k] for k in source])
        lines.append(f"    const lieid_v t{i} = {text};")
        value[target[0]] = f"t{i}"
        pending.pop(target[0], None)
    return lines, used


def _input(argument: int, j: int, *, constant: bool) -> str:
    if constant:
        return f"lieid_splat(in[{argument}][{j}])"
    return f"lieid_load(in[{argument}] + {j} * LIEID_LANES)"


def _places(sparse: SparseFunction, order: Indices) -> dict[int, tuple[int, int]]:
    """Return for each nonzero its row and its rank among the nonzeros of that row."""
    places, filled = {}, [0] * sparse.shape[0]
    for nonzero in order:
        row = int(sparse.rows[nonzero])
        places[int(nonzero)] = row, filled[row]
        filled[row] += 1
    return places


def _expression(operation: str, operands: list[str]) -> str:
    if operation in _INFIX:
        return f"{operands[0]} {_INFIX[operation]} {operands[1]}"
    if operation in _PATTERNS:
        return _PATTERNS[operation].format(*operands)
    if operation in _MACROS:
        return f"LIEID_{operation}({', '.join(operands)})"
    if operation in _FUNCTIONS:
        return f"lieid_{operation.lower()}({', '.join(operands)})"
    raise UnsupportedOperation(f"CasADi's operation {operation} has no C form here")


@cache
def _operation_names() -> dict[int, str]:
    return {getattr(ca, name): name[3:] for name in dir(ca) if name.startswith("OP_")}


def _number(value: float) -> str:
    if math.isfinite(value):
        return repr(float(value))
    return "NAN" if math.isnan(value) else ("INFINITY" if value > 0 else "-INFINITY")


def _numbers(values: Indices) -> str:
    return ", ".join(str(int(value)) for value in values) or "0"
