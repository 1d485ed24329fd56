"""The functions that are compiled: those of a model, and some for compiled code alone."""

from __future__ import annotations

from functools import cached_property

import casadi as ca
import numpy as np

from lieid_casadi.dynamics.recursion import ReferenceMotion
from lieid_casadi.dynamics.regressor import slotine_li_regressor
from lieid_casadi.expressions.model_functions import ModelFunctions, SparseFunction, sparse_function


class KernelFunctions(ModelFunctions):
    """`ModelFunctions` and further expressions that only compiled code uses."""

    @cached_property
    def _effect_inputs(self) -> tuple[list[ca.SX], list[str]]:
        function = self.effect_columns.function
        names = [str(function.name_in(k)) for k in range(function.n_in())]
        motion = {"q": self.motion.q, "dq": self.motion.dq, "ddq": self.motion.ddq}
        return [motion[k] if k in motion else getattr(self, k) for k in names], names

    @cached_property
    def _effect_matrix(self) -> ca.SX:
        inputs, _ = self._effect_inputs
        sparse = self.effect_columns
        matrix = ca.SX(*sparse.shape)
        values = sparse.function(*inputs)
        for k, (row, column) in enumerate(zip(sparse.rows, sparse.columns, strict=True)):
            matrix[int(row), int(column)] = values[k]
        return matrix

    @cached_property
    def base_effects(self) -> SparseFunction:
        """The effect columns that the base regressor keeps (n, k)."""
        kept = self.model.base.kept - 10 * self.model.n
        inputs, names = self._effect_inputs
        matrix = self._effect_matrix[:, [int(k) for k in kept[kept >= 0]]]
        return sparse_function("base_effects", inputs, names, matrix)

    @cached_property
    def friction(self) -> SparseFunction:
        """Torque of all effects (n, 1), given their linear coefficients."""
        coefficients = ca.SX.sym("coefficients", len(self.model.columns))
        inputs, names = self._effect_inputs
        torque = ca.densify(ca.mtimes(self._effect_matrix, coefficients))
        return sparse_function(
            "friction", [*inputs, coefficients], [*names, "coefficients"], torque
        )

    @cached_property
    def memory(self) -> SparseFunction:
        """States (S, 1) at a sample, from its signals and the states and signals before it."""
        step, count = self.advance, len(self.model.states)
        names = [str(step.name_in(k)) for k in range(step.n_in())]
        inputs = [ca.SX.sym(name, step.size1_in(k)) for k, name in enumerate(names)]
        after = ca.densify(step(*inputs))
        function = ca.Function("memory", inputs, [after], names, ["nonzeros"], {"cse": True})
        return SparseFunction(
            function, np.arange(count), np.zeros(count, dtype=np.intp), (count, 1)
        )

    @cached_property
    def slotine_li_regressor(self) -> SparseFunction:
        """Y(q, q̇, q̇_r, q̈_r) (n, 10 n)."""
        m, n = self.motion, self.model.n
        dq_r, ddq_r = ca.SX.sym("dq_r", n), ca.SX.sym("ddq_r", n)
        inputs = [m.q, m.sin, m.cos, m.dq, dq_r, ddq_r]
        names = ["q", "sin", "cos", "dq", "dq_r", "ddq_r"]
        matrix = slotine_li_regressor(self.model.robot, m, ReferenceMotion(dq_r, ddq_r))
        return sparse_function("slotine_li_regressor", inputs, names, matrix)
