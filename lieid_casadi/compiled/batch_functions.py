"""Evaluation of a model's functions on batches by name; `Compiled` gives them their signatures."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import ArrayLike

from lieid_casadi.arrays import Array
from lieid_casadi.compiled import array_checks
from lieid_casadi.compiled.batch_evaluation import (
    CompiledEvaluation,
    Evaluation,
    MachineEvaluation,
)
from lieid_casadi.compiled.kernel_functions import KernelFunctions
from lieid_casadi.compiled.kernels import Kernels
from lieid_casadi.compiled.memory_states import states_along
from lieid_casadi.compiled.threads import default_threads
from lieid_casadi.model import Model

# Functions that consist of several parts side by side; the others are one part of the same name.
_PARTS = {
    "base_regressor": ("base_regressor", "base_effects"),
    "rigid_base_regressor": ("base_regressor",),
}


class BatchFunctions:
    """The functions of one model, each built when it is first called; see `Compiled`."""

    def __init__(
        self, model: Model, *, threads: int | None = None, lanes: int | None = None
    ) -> None:
        self.model = model
        self.functions = KernelFunctions(model)
        self.threads = default_threads() if threads is None else threads
        self._kernels = Kernels(self.functions, lanes)
        self._memory = Kernels(self.functions, lanes=1)
        self._evaluations: dict[str, Evaluation] = {}

    @property
    def n(self) -> int:
        """Number of joints."""
        return self.model.n

    def _samples(self, **signals: ArrayLike) -> dict[str, Array]:
        """Check signals (N, n) of equal N."""
        values: dict[str, Array] = {}
        count = None
        for name, signal in signals.items():
            values[name] = array_checks.samples(name, signal, self.n, count)
            count = len(values[name])
        return values

    def _motion(self, q: ArrayLike, dq: ArrayLike, ddq: ArrayLike) -> dict[str, Array]:
        return self._samples(q=q, dq=dq, ddq=ddq)

    def _signals(
        self,
        motion: dict[str, Array],
        load: ArrayLike | None,
        temperature: ArrayLike | None,
        time: ArrayLike | None,
        command_error: ArrayLike | None,
        shapes: ArrayLike | None,
        dead_zone: ArrayLike | None,
    ) -> dict[str, Array]:
        """Return the motion and the other signals of effects; signals that are None stay zero."""
        start, count = self.model.initial_shapes, len(motion["q"])
        values = motion | {
            "shapes": array_checks.constants(
                "shapes", start if shapes is None else shapes, len(start)
            ),
            "dead_zone": array_checks.constants(
                "dead_zone", np.zeros(self.n) if dead_zone is None else dead_zone, self.n
            ),
        }
        if load is not None:
            values["load"] = array_checks.samples("load", load, self.n, count)
        if temperature is not None:
            values["temperature"] = array_checks.samples("temperature", temperature, self.n, count)
        if command_error is not None:
            errors = array_checks.samples("command_error", command_error, self.n, count)
            values["command_error"] = errors
        if time is not None:
            values["time"] = array_checks.times(time, count)
        if self.model.states:
            values["states"] = states_along(self._memory, values)
        return values

    def _links(self, parameters: ArrayLike) -> dict[str, Array]:
        return {"parameters": array_checks.constants("parameters", parameters, 10 * self.n)}

    def _matrix(
        self, name: str, values: Mapping[str, Array], out: Array | None, threads: int | None
    ) -> Array:
        evaluation = self._evaluation(name)
        result = array_checks.output(out, (len(values["q"]), *evaluation.layout.shape))
        self._run(evaluation, values, result, threads)
        return result

    def _vector(
        self, name: str, values: Mapping[str, Array], out: Array | None, threads: int | None
    ) -> Array:
        """Evaluate a function whose matrices are columns."""
        evaluation = self._evaluation(name)
        result = array_checks.output(out, (len(values["q"]), evaluation.layout.shape[0]))
        self._run(evaluation, values, result[:, :, None], threads)
        return result

    def _run(
        self, evaluation: Evaluation, values: Mapping[str, Array], out: Array, threads: int | None
    ) -> None:
        apart = {k: v.copy() if np.may_share_memory(v, out) else v for k, v in values.items()}
        evaluation.bind(apart).dense(out, self.threads if threads is None else threads)

    def _evaluation(self, name: str) -> Evaluation:
        if name not in self._evaluations:
            self._evaluations[name] = self._make_evaluation(name)
        return self._evaluations[name]

    def _make_evaluation(self, name: str) -> Evaluation:
        first_columns, shape = self._extent(name)
        parts = [
            (part, first)
            for part, first in zip(_PARTS.get(name, (name,)), first_columns, strict=True)
            if first < shape[1]  # a model without effects has no columns of theirs
        ]
        names, first_columns = [part for part, _ in parts], tuple(first for _, first in parts)
        compiled = self._kernels.get(names) if parts else None
        if compiled is not None:
            return CompiledEvaluation(*compiled, first_columns, shape)
        functions = [getattr(self.functions, part) for part in names]
        return MachineEvaluation(functions, first_columns, shape)

    def _extent(self, name: str) -> tuple[tuple[int, ...], tuple[int, int]]:
        """Return the first column of each part, and the whole matrix's shape."""
        n = self.n
        if name in ("base_regressor", "rigid_base_regressor"):
            kept = self.model.base.kept
            starts = (0, int(np.sum(kept < 10 * n)))
            return starts[: len(_PARTS[name])], (n, len(kept))
        shapes = {
            "regressor": (n, 10 * n), "slotine_li_regressor": (n, 10 * n),
            "effect_columns": (n, len(self.model.columns)), "mass_matrix": (n, n),
            "coriolis_matrix": (n, n), "jacobian": (6, n),
        }  # fmt: skip
        return (0,), shapes.get(name, (n, 1))
