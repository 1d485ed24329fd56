"""CasADi expressions evaluated on NumPy arrays, operation by operation.

Screening evaluates hundreds of columns once each. Compiling them would take longer than the
evaluation, and CasADi's virtual machine evaluates samples one by one.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import casadi as ca
import numpy as np
from scipy.special import erf

from lieid_casadi.arrays import Array


def _if_else_zero(condition: Array, value: Array) -> Array:
    return np.where(condition != 0.0, value, 0.0)


_OPERATIONS: dict[int, Callable[..., Any]] = {
    ca.OP_ASSIGN: lambda x: x,
    ca.OP_ADD: np.add,
    ca.OP_SUB: np.subtract,
    ca.OP_MUL: np.multiply,
    ca.OP_DIV: np.divide,
    ca.OP_NEG: np.negative,
    ca.OP_EXP: np.exp,
    ca.OP_LOG: np.log,
    ca.OP_POW: np.power,
    ca.OP_CONSTPOW: np.power,
    ca.OP_SQRT: np.sqrt,
    ca.OP_SQ: np.square,
    ca.OP_TWICE: lambda x: 2.0 * x,
    ca.OP_SIN: np.sin,
    ca.OP_COS: np.cos,
    ca.OP_TAN: np.tan,
    ca.OP_ASIN: np.arcsin,
    ca.OP_ACOS: np.arccos,
    ca.OP_ATAN: np.arctan,
    ca.OP_LT: lambda x, y: np.less(x, y).astype(float),
    ca.OP_LE: lambda x, y: np.less_equal(x, y).astype(float),
    ca.OP_EQ: lambda x, y: np.equal(x, y).astype(float),
    ca.OP_NE: lambda x, y: np.not_equal(x, y).astype(float),
    ca.OP_NOT: lambda x: np.equal(x, 0.0).astype(float),
    ca.OP_AND: lambda x, y: np.logical_and(x, y).astype(float),
    ca.OP_OR: lambda x, y: np.logical_or(x, y).astype(float),
    ca.OP_FLOOR: np.floor,
    ca.OP_CEIL: np.ceil,
    ca.OP_FMOD: np.fmod,
    ca.OP_FABS: np.abs,
    ca.OP_SIGN: np.sign,
    ca.OP_COPYSIGN: np.copysign,
    ca.OP_IF_ELSE_ZERO: _if_else_zero,
    ca.OP_ERF: erf,
    ca.OP_FMIN: np.minimum,
    ca.OP_FMAX: np.maximum,
    ca.OP_INV: np.reciprocal,
    ca.OP_SINH: np.sinh,
    ca.OP_COSH: np.cosh,
    ca.OP_TANH: np.tanh,
    ca.OP_ASINH: np.arcsinh,
    ca.OP_ACOSH: np.arccosh,
    ca.OP_ATANH: np.arctanh,
    ca.OP_ATAN2: np.arctan2,
    ca.OP_LOG1P: np.log1p,
    ca.OP_EXPM1: np.expm1,
    ca.OP_HYPOT: np.hypot,
}


class ArrayFunction:
    """A function of scalars, evaluated on arrays that broadcast against each other.

    Parameters
    ----------
    inputs : sequence of ca.SX
        Scalar symbols.
    outputs : sequence of ca.SX
        Scalar expressions of them.

    Examples
    --------
    >>> import casadi as ca, numpy as np
    >>> x, y = ca.SX.sym("x"), ca.SX.sym("y")
    >>> function = ArrayFunction([x, y], [ca.sin(x) * y, x])
    >>> [float(v[1]) for v in function(np.array([0.0, 1.0]), 2.0)]
    [1.682941969615793, 1.0]
    """

    def __init__(self, inputs: Sequence[ca.SX], outputs: Sequence[ca.SX]) -> None:
        f = ca.Function("f", list(inputs), [ca.SX(x) for x in outputs], {"cse": True})
        self._count = len(outputs)
        self._program = []
        for k in range(f.n_instructions()):
            code, arguments = f.instruction_id(k), f.instruction_input(k)
            constant = f.instruction_constant(k) if code == ca.OP_CONST else 0.0
            self._program.append((code, arguments, f.instruction_output(k), constant))
            if code not in (ca.OP_CONST, ca.OP_INPUT, ca.OP_OUTPUT) and code not in _OPERATIONS:
                raise NotImplementedError(
                    f"CasADi operation {code} has no NumPy equivalent here; add it to _OPERATIONS"
                )

    def __call__(self, *inputs: Array | float) -> list[Array]:
        """Return the value of each output."""
        work: dict[int, Any] = {}
        results: list[Any] = [0.0] * self._count
        with np.errstate(all="ignore"):
            for code, arguments, target, constant in self._program:
                if code == ca.OP_CONST:
                    work[target[0]] = constant
                elif code == ca.OP_INPUT:
                    work[target[0]] = inputs[arguments[0]]
                elif code == ca.OP_OUTPUT:
                    results[target[0]] = work[arguments[0]]
                else:
                    operands = (work[a] for a in arguments)
                    work[target[0]] = _OPERATIONS[code](*operands)
        return results
