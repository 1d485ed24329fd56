"""The C source of kernels.

A kernel is straight-line code on vectors of samples: values have the type `lieid_v` of
``codegen/lieid_lanes.h``. The same text serves every number of lanes, one included.
"""

from __future__ import annotations

import math

import numpy as np

from lieid_casadi.arrays import Indices
from lieid_casadi.expressions.c_writer import ARITHMETIC, Dialect, Statements, statements
from lieid_casadi.expressions.model_functions import SparseFunction

# Arguments that are the same for every sample; all others differ from sample to sample.
CONSTANT_ARGUMENTS = frozenset({"parameters", "coefficients", "shapes", "dead_zone"})

_UNARY = (
    "SQRT", "FABS", "SIGN", "EXP", "SIN", "COS", "TAN", "ASIN", "ACOS", "ATAN", "SINH", "COSH",
    "TANH", "LOG", "LOG1P", "EXPM1", "ERF", "FLOOR", "CEIL",
)  # fmt: skip
_BINARY = ("FMIN", "FMAX", "ATAN2", "FMOD", "HYPOT", "COPYSIGN")
_MACROS = ("LT", "LE", "EQ", "NE", "AND", "OR", "IF_ELSE_ZERO")


def _number(value: float) -> str:
    text = repr(float(value))
    if not math.isfinite(value):
        text = "NAN" if math.isnan(value) else ("INFINITY" if value > 0 else "-INFINITY")
    return f"lieid_splat({text})"


VECTORS = Dialect(
    declaration="const lieid_v",
    patterns=ARITHMETIC
    | {name: f"lieid_{name.lower()}({{0}})" for name in _UNARY}
    | {name: f"lieid_{name.lower()}({{0}}, {{1}})" for name in _BINARY}
    | {name: f"LIEID_{name}({{0}}, {{1}})" for name in _MACROS}
    | {"NOT": "LIEID_NOT({0})"},
    number=_number,
)


def kernel_source(sparse: SparseFunction) -> str:
    """Return the C source of a kernel that evaluates a sparse matrix on LIEID_LANES samples.

    The kernel ``void lieid_kernel(in, rows, ld)`` reads value j of argument a at ``in[a] + j *
    LIEID_LANES`` (constants at ``in[a][j]``), and writes the k-th nonzero of matrix row i, columns
    ascending, to ``rows[i] + k * ld``. Further symbols hold the shape, the place of each nonzero
    (row after row) and the arguments with their widths, 0 if unused.
    """
    function = sparse.function
    names = [str(function.name_in(k)) for k in range(function.n_in())]
    order = np.lexsort((sparse.columns, sparse.rows))
    body = _body(sparse, names, order)
    used = {names[given.argument] for given in body.inputs}
    if {"sin", "cos"} & used:
        used.add("q")  # the runtime computes them from it
    arguments = " ".join(
        f"{name}:{int(function.size1_in(k)) if name in used else 0}" for k, name in enumerate(names)
    )
    text = "\n".join(f"    {line}" for line in body.lines)
    return (
        '#include "lieid_lanes.h"\n'
        f"const int32_t lieid_shape[3] = {{{sparse.shape[0]}, {sparse.shape[1]}, {len(order)}}};\n"
        f'const char lieid_arguments[] = "{arguments}";\n'
        f"const int32_t lieid_rows[] = {{{_numbers(sparse.rows[order])}}};\n"
        f"const int32_t lieid_columns[] = {{{_numbers(sparse.columns[order])}}};\n"
        "void lieid_kernel(const double *const *restrict in, double *const *restrict rows,"
        " ptrdiff_t ld)\n"
        f"{{\n    (void)in, (void)rows, (void)ld;\n{text}\n}}\n"
    )


def _body(sparse: SparseFunction, names: list[str], order: Indices) -> Statements:
    places = _places(sparse, order)

    def read(argument: int, j: int) -> tuple[str, str]:
        if names[argument] in CONSTANT_ARGUMENTS:
            return f"x{argument}_{j}", f"lieid_splat(in[{argument}][{j}])"
        return f"x{argument}_{j}", f"lieid_load(in[{argument}] + {j} * LIEID_LANES)"

    def write(nonzero: int, value: str) -> str:
        row, k = places[nonzero]
        return f"lieid_store(rows[{row}] + {k} * ld, {value});"

    return statements(sparse.function, VECTORS, read=read, write=write, inputs_in_place=True)


def _places(sparse: SparseFunction, order: Indices) -> dict[int, tuple[int, int]]:
    """Return for each nonzero its row and its rank among the nonzeros of that row."""
    places, filled = {}, [0] * sparse.shape[0]
    for nonzero in order:
        row = int(sparse.rows[nonzero])
        places[int(nonzero)] = row, filled[row]
        filled[row] += 1
    return places


def _numbers(values: Indices) -> str:
    return ", ".join(str(int(value)) for value in values) or "0"
