"""Batch evaluation of a model: NumPy in, NumPy out."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lieid_casadi.compiled import array_checks
from lieid_casadi.compiled.base_regressor_blocks import BaseBlocks
from lieid_casadi.compiled.batch_evaluation import (
    CompiledEvaluation,
    Evaluation,
    MachineEvaluation,
    default_threads,
)
from lieid_casadi.compiled.kernel_functions import KernelFunctions
from lieid_casadi.compiled.kernels import Kernels
from lieid_casadi.compiled.memory_states import states_along
from lieid_casadi.model import Model

Array = NDArray[np.float64]
# Functions that are put together; the others have one part of their own name.
_PARTS = {
    "base_regressor": ("base_regressor", "base_effects"),
    "rigid_base_regressor": ("base_regressor",),
}


def compile(model: Model, *, threads: int | None = None, lanes: int | None = None) -> Compiled:
    """Return the model's functions for batches of samples.

    Each function becomes C, compiled by the system's compiler when it is first called and kept in
    the user's cache folder (``$LIEID_CACHE_DIR``, else ``~/.cache/lieid-casadi``). Without a
    working compiler CasADi's virtual machine evaluates the same expressions, and a logged warning
    says so once.

    Parameters
    ----------
    threads : int, optional
        Threads that share a large batch; two if left out.
    lanes : int, optional
        Samples per vector register (8, 4, 2 or 1); the most that the processor has if left out.
        Results have the same bits with any number of lanes.

    Examples
    --------
    >>> import lieid_casadi as lieid
    >>> arm = lieid.compile(lieid.Model(lieid.robots.two_link(), effects=["viscous"]))
    >>> arm.regressor([[0.1, 0.2]], [[0.0, 0.0]], [[0.0, 0.0]]).shape
    (1, 2, 20)
    """
    return Compiled(model, threads=threads, lanes=lanes)


class Compiled:
    """A model's functions on arrays of N samples: q, dq, ddq (N, n) in rad and seconds.

    Arrays may have any strides. ``out`` is a C-contiguous array of the result's shape to write to,
    ``threads`` how many may work on this call. NaN in a sample gives NaN in that sample only.
    Every method raises `ModelError` for arrays of the wrong shape or kind.
    """

    def __init__(
        self, model: Model, *, threads: int | None = None, lanes: int | None = None
    ) -> None:
        self.model = model
        self.functions = KernelFunctions(model)
        self.threads = default_threads() if threads is None else threads
        self._kernels = Kernels(self.functions, lanes)
        self._memory = Kernels(self.functions, lanes=1)
        self._evaluations: dict[str, Evaluation] = {}

    @cached_property
    def n(self) -> int:
        """Number of joints."""
        return self.model.n

    def regressor(
        self,
        q: ArrayLike,
        dq: ArrayLike,
        ddq: ArrayLike,
        *,
        out: Array | None = None,
        threads: int | None = None,
    ) -> Array:
        """Return the full regressor Y (N, n, 10 n) of the rigid torque.

        Parameters
        ----------
        q, dq, ddq : (N, n)
            rad, rad/s, rad/s² (m for a prismatic joint).
        out : (N, …) array, optional
            Result array to write into.
        threads : int, optional
            Threads that share the batch.
        """
        return self._matrix("regressor", self._motion(q, dq, ddq), out, threads)

    def slotine_li_regressor(
        self,
        q: ArrayLike,
        dq: ArrayLike,
        dq_r: ArrayLike,
        ddq_r: ArrayLike,
        *,
        out: Array | None = None,
        threads: int | None = None,
    ) -> Array:
        """Return Y(q, q̇, q̇_r, q̈_r) (N, n, 10 n): Y·π = M·q̈_r + C·q̇_r + G with Ṁ − 2C skew.

        q̇_r, q̈_r are the reference motion of an adaptive controller (Slotine, Li, "On the adaptive
        control of robot manipulators", IJRR 1987).

        Parameters
        ----------
        q, dq : (N, n)
            rad, rad/s.
        dq_r, ddq_r : (N, n)
            Reference velocity and acceleration, rad/s, rad/s².
        out, threads : optional
            As in `regressor`.
        """
        values = self._samples(q=q, dq=dq, dq_r=dq_r, ddq_r=ddq_r)
        return self._matrix("slotine_li_regressor", values, out, threads)

    def base_regressor(
        self,
        q: ArrayLike,
        dq: ArrayLike,
        ddq: ArrayLike,
        *,
        load: ArrayLike | None = None,
        temperature: ArrayLike | None = None,
        time: ArrayLike | None = None,
        shapes: ArrayLike | None = None,
        dead_zone: ArrayLike | None = None,
        out: Array | None = None,
        threads: int | None = None,
    ) -> Array:
        """Return Y_b (N, n, p): the kept columns of [Y, effect columns].

        Parameters
        ----------
        load : (N, n), optional
            τ_load, N·m; zero if left out.
        temperature : (N, n), optional
            °C relative to the training mean; zero if left out.
        time : (N,), optional
            s; zero if left out.
        shapes : (s,), optional
            Shape parameters; the effects' start values if left out.
        dead_zone : (n,), optional
            Over |q̇| below it the sign ramps from −1 to 1, rad/s; zero if left out.
        """
        motion = self._motion(q, dq, ddq)
        values = self._signals(motion, load, temperature, time, shapes, dead_zone)
        return self._matrix("base_regressor", values, out, threads)

    def rigid_base_regressor(
        self,
        q: ArrayLike,
        dq: ArrayLike,
        ddq: ArrayLike,
        *,
        out: Array | None = None,
        threads: int | None = None,
    ) -> Array:
        """Return Y_b (N, n, p) with zeros in the columns of effects.

        Parameters
        ----------
        q, dq, ddq : (N, n)
            rad, rad/s, rad/s² (m for a prismatic joint).
        out, threads : optional
            As in `regressor`.
        """
        return self._matrix("rigid_base_regressor", self._motion(q, dq, ddq), out, threads)

    def base_blocks(
        self,
        q: ArrayLike,
        dq: ArrayLike,
        ddq: ArrayLike,
        *,
        load: ArrayLike | None = None,
        temperature: ArrayLike | None = None,
        time: ArrayLike | None = None,
        shapes: ArrayLike | None = None,
        dead_zone: ArrayLike | None = None,
        size: int | None = None,
    ) -> BaseBlocks:
        """Return Y_b in blocks that stay in cache; arguments as for `base_regressor`.

        Parameters
        ----------
        size : int, optional
            Samples per block; as many as half a second-level cache holds if left out.
        """
        motion = self._motion(q, dq, ddq)
        values = self._signals(motion, load, temperature, time, shapes, dead_zone)
        return BaseBlocks(self._evaluation("base_regressor"), values, len(values["q"]), size)

    def effect_columns(
        self,
        q: ArrayLike,
        dq: ArrayLike,
        ddq: ArrayLike,
        *,
        load: ArrayLike | None = None,
        temperature: ArrayLike | None = None,
        time: ArrayLike | None = None,
        shapes: ArrayLike | None = None,
        dead_zone: ArrayLike | None = None,
        out: Array | None = None,
        threads: int | None = None,
    ) -> Array:
        """Return the effects' columns (N, n, m), dropped ones included; see `base_regressor`.

        For effects with memory the samples are one segment, in order, from its first one.

        Parameters
        ----------
        q, dq, ddq : (N, n)
            rad, rad/s, rad/s² (m for a prismatic joint).
        load, temperature, time, shapes, dead_zone : optional
            As in `base_regressor`.
        out, threads : optional
            As in `regressor`.
        """
        motion = self._motion(q, dq, ddq)
        values = self._signals(motion, load, temperature, time, shapes, dead_zone)
        return self._matrix("effect_columns", values, out, threads)

    def friction(
        self,
        q: ArrayLike,
        dq: ArrayLike,
        ddq: ArrayLike,
        coefficients: ArrayLike,
        *,
        load: ArrayLike | None = None,
        temperature: ArrayLike | None = None,
        time: ArrayLike | None = None,
        shapes: ArrayLike | None = None,
        dead_zone: ArrayLike | None = None,
        out: Array | None = None,
        threads: int | None = None,
    ) -> Array:
        """Return the torque of all effects (N, n) for linear coefficients (m,).

        Parameters
        ----------
        q, dq, ddq : (N, n)
            rad, rad/s, rad/s² (m for a prismatic joint).
        coefficients : (m,)
            Linear coefficients of the effects.
        load, temperature, time, shapes, dead_zone : optional
            As in `base_regressor`.
        out, threads : optional
            As in `regressor`.
        """
        motion = self._motion(q, dq, ddq)
        values = self._signals(motion, load, temperature, time, shapes, dead_zone)
        width = len(self.model.columns)
        values["coefficients"] = array_checks.constants("coefficients", coefficients, width)
        return self._vector("friction", values, out, threads)

    def inverse_dynamics(
        self,
        q: ArrayLike,
        dq: ArrayLike,
        ddq: ArrayLike,
        parameters: ArrayLike,
        *,
        out: Array | None = None,
        threads: int | None = None,
    ) -> Array:
        """Return the rigid torque (N, n) of link parameters (10 n,), N·m.

        Parameters
        ----------
        q, dq, ddq : (N, n)
            rad, rad/s, rad/s² (m for a prismatic joint).
        parameters : (10 n,)
            Link parameters in the order of `Robot.link_parameters`.
        out, threads : optional
            As in `regressor`.
        """
        values = self._motion(q, dq, ddq) | self._links(parameters)
        return self._vector("inverse_dynamics", values, out, threads)

    def mass_matrix(
        self,
        q: ArrayLike,
        parameters: ArrayLike,
        *,
        out: Array | None = None,
        threads: int | None = None,
    ) -> Array:
        """Return M(q) (N, n, n), kg·m².

        Parameters
        ----------
        q : (N, n)
            rad.
        parameters : (10 n,)
            Link parameters in the order of `Robot.link_parameters`.
        out, threads : optional
            As in `regressor`.
        """
        values = self._samples(q=q) | self._links(parameters)
        return self._matrix("mass_matrix", values, out, threads)

    def coriolis_matrix(
        self,
        q: ArrayLike,
        dq: ArrayLike,
        parameters: ArrayLike,
        *,
        out: Array | None = None,
        threads: int | None = None,
    ) -> Array:
        """Return C(q, q̇) (N, n, n) with Ṁ − 2C skew-symmetric.

        Parameters
        ----------
        q, dq : (N, n)
            rad, rad/s.
        parameters : (10 n,)
            Link parameters in the order of `Robot.link_parameters`.
        out, threads : optional
            As in `regressor`.
        """
        values = self._samples(q=q, dq=dq) | self._links(parameters)
        return self._matrix("coriolis_matrix", values, out, threads)

    def gravity(
        self,
        q: ArrayLike,
        parameters: ArrayLike,
        *,
        out: Array | None = None,
        threads: int | None = None,
    ) -> Array:
        """Return G(q) (N, n), N·m.

        Parameters
        ----------
        q : (N, n)
            rad.
        parameters : (10 n,)
            Link parameters in the order of `Robot.link_parameters`.
        out, threads : optional
            As in `regressor`.
        """
        values = self._samples(q=q) | self._links(parameters)
        return self._vector("gravity", values, out, threads)

    def jacobian(
        self, q: ArrayLike, *, out: Array | None = None, threads: int | None = None
    ) -> Array:
        """Return the tool's Jacobian (N, 6, n), [ω; v] in base axes.

        Parameters
        ----------
        q : (N, n)
            rad.
        out, threads : optional
            As in `regressor`.
        """
        return self._matrix("jacobian", self._samples(q=q), out, threads)

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
        shapes: ArrayLike | None,
        dead_zone: ArrayLike | None,
    ) -> dict[str, Array]:
        """Return the motion and what effects see beside it; what is left out stays zero."""
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
