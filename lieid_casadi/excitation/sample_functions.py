"""Functions of one motion sample, evaluated on many samples: compiled, or by CasADi itself."""

from __future__ import annotations

from collections.abc import Mapping
from types import SimpleNamespace
from typing import cast

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from lieid_casadi.compiled.batch_evaluation import CompiledEvaluation, Evaluation, MachineEvaluation
from lieid_casadi.compiled.kernel_functions import KernelFunctions
from lieid_casadi.compiled.kernels import Kernels
from lieid_casadi.dynamics.lie import Motion as Symbols
from lieid_casadi.excitation.basis.trajectory import MotionSamples
from lieid_casadi.expressions.model_functions import sparse_function

Array = NDArray[np.float64]


class SampleKernel:
    """A sparse matrix function of q, dq, ddq (and further vectors) per sample.

    Parameters
    ----------
    name : str
        Of the function, unique in the problem.
    symbols : Symbols
        Symbols of the expression; sines and cosines of q are separate inputs.
    matrix : SX
    further : mapping, optional
        Name → symbol (w,) of further inputs, given per sample as (N, w).
    """

    def __init__(
        self,
        name: str,
        symbols: Symbols,
        matrix: ca.SX,
        further: Mapping[str, ca.SX] | None = None,
    ) -> None:
        inputs = {
            "q": symbols.q,
            "sin": symbols.sin,
            "cos": symbols.cos,
            "dq": symbols.dq,
            "ddq": symbols.ddq,
            **(further or {}),
        }
        self._sparse = sparse_function(name, list(inputs.values()), list(inputs), matrix)
        self._name = name
        self._evaluation = self._make_evaluation()

    @property
    def rows(self) -> NDArray[np.int64]:
        """Row of each value (nnz,)."""
        return self._evaluation.layout.rows

    @property
    def columns(self) -> NDArray[np.int64]:
        """Column of each value (nnz,)."""
        return self._evaluation.layout.columns

    @property
    def shape(self) -> tuple[int, int]:
        """Shape of the matrix."""
        return self._sparse.shape

    def values(self, motion: MotionSamples, **further: Array) -> Array:
        """Return the values (nnz, N) at every sample."""
        samples = len(motion)
        out = np.empty((len(self.rows), samples))
        inputs = {"q": motion.q, "dq": motion.dq, "ddq": motion.ddq, **further}
        self._evaluation.bind(inputs).columns(0, samples, out)
        return out

    def dense(self, motion: MotionSamples, **further: Array) -> Array:
        """Return the matrices (rows, columns, N)."""
        out = np.zeros((*self.shape, len(motion)))
        out[self.rows, self.columns] = self.values(motion, **further)
        return out

    def _make_evaluation(self) -> Evaluation:
        # Kernels reads its functions as attributes
        functions = cast(KernelFunctions, SimpleNamespace(**{self._name: self._sparse}))
        compiled = Kernels(functions).get([self._name])
        if compiled is not None:
            return CompiledEvaluation(*compiled, (0,), self._sparse.shape)
        return MachineEvaluation([self._sparse], (0,), self._sparse.shape)


def reverse_derivative(values: ca.SX, seed: ca.SX, symbols: Symbols) -> ca.SX:
    """Return seedᵀ·∂values/∂(q, dq, ddq) (3 n, 1) by reverse differentiation.

    Parameters
    ----------
    values : SX (k,)
    seed : SX (k,)
    symbols : Symbols
        Sines and cosines are separate symbols; their part follows by the chain rule.
    """
    s = symbols
    inputs = ca.vertcat(s.q, s.sin, s.cos, s.dq, s.ddq)
    gradient = ca.jtimes(values, inputs, seed, True)
    q, sine, cosine, dq, ddq = ca.vertsplit(gradient, s.q.size1())
    return ca.vertcat(q + sine * s.cos - cosine * s.sin, dq, ddq)


def motion_jacobian(values: ca.SX, symbols: Symbols) -> ca.SX:
    """Return ∂values/∂(q, dq, ddq) (k, 3 n), sparse."""
    s = symbols
    q, sine, cosine = (ca.jacobian(values, x) for x in (s.q, s.sin, s.cos))
    turning = ca.mtimes(sine, ca.diag(s.cos)) - ca.mtimes(cosine, ca.diag(s.sin))
    return ca.horzcat(q + turning, ca.jacobian(values, s.dq), ca.jacobian(values, s.ddq))
