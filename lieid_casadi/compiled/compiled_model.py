"""Batch evaluation of a model: NumPy in, NumPy out."""

from __future__ import annotations

import os
import re
from collections.abc import Mapping
from typing import Any, Literal, TypedDict, Unpack

import numpy as np
from numpy.typing import ArrayLike

from lieid_casadi.arrays import Array
from lieid_casadi.compiled import batch_evaluation
from lieid_casadi.compiled.kernels import Kernels
from lieid_casadi.effects import ArmEffect
from lieid_casadi.errors import ModelError
from lieid_casadi.expressions.model_functions import ModelFunctions
from lieid_casadi.model import Model, as_model
from lieid_casadi.robot import Robot

# Functions that consist of several parts side by side; the others are one part of the same name.
_PARTS = {
    "base_regressor": ("base_regressor", "base_effects"),
    "base_links": ("base_regressor",),
    "base_effects": ("base_effects",),
}
Part = Literal["base_regressor", "base_links", "base_effects"]
_VECTORS = ("inverse_dynamics", "gravity", "effect_torque")
_FLOAT = np.dtype(np.float64)


class Call(TypedDict, total=False):
    """Where a result goes, and how many threads compute it."""

    out: Array | None
    threads: int | None


class EffectSignals(TypedDict, total=False):
    """What effects depend on besides the motion; what is left out or None stays zero."""

    load: ArrayLike | None
    temperature: ArrayLike | None
    time: ArrayLike | None
    command_error: ArrayLike | None
    shapes: ArrayLike | None
    dead_zone: ArrayLike | None


class EffectCall(Call, EffectSignals, total=False):
    """Both."""


def compile(
    model: Model | Robot, *, threads: int | None = None, lanes: int | None = None
) -> Compiled:
    """Return the model's functions for batches of samples.

    Each function becomes C, compiled by the system's compiler when it is first called and kept in
    the user's cache folder (``$LIEID_CACHE_DIR``, else ``~/.cache/lieid-casadi``). Without a
    working compiler CasADi's virtual machine evaluates the same expressions, and one warning is
    logged.

    Parameters
    ----------
    model : Model or Robot
        A robot stands for its model without effects.
    threads : int, optional
        Threads that share a large batch; two if left out.
    lanes : int, optional
        Samples per vector register (8, 4, 2 or 1); the most that the processor has if left out.
        Results have the same bits with any number of lanes.

    Returns
    -------
    Compiled

    Raises
    ------
    ModelError
        Neither a model nor a robot.
    RobotError
        The robot's geometry contains symbols.

    Examples
    --------
    >>> import lieid_casadi as lieid
    >>> arm = lieid.compile(lieid.Model(lieid.robots.two_link(), effects=["viscous"]))
    >>> arm.regressor([[0.1, 0.2]], [[0.0, 0.0]], [[0.0, 0.0]]).shape
    (1, 2, 20)
    """
    return Compiled(as_model(model), threads=threads, lanes=lanes)


class Compiled:
    """A model's functions on arrays of N samples, each built when first called; see `compile`.

    Arrays may have any strides. NaN in a sample gives NaN in that sample only; effects with memory
    hold their state there (`Effect.next_states`).

    Notes
    -----
    Arguments of the methods:

    q, dq, ddq : (N, n)
        rad, rad/s, rad/s².
    parameters : (10 n,)
        Link parameters.
    out : array, optional
        C-contiguous array of the result's shape to write to.
    threads : int, optional
        Threads for this call.

    Functions of effects also take, by name:

    load : (N, n)
        τ_load, N·m; zero if left out.
    temperature : (N, n)
        °C relative to the training mean; zero if left out.
    time : (N,)
        s; zero if left out.
    command_error : (N, n)
        Commanded minus measured position, rad; zero if left out.
    shapes : (s,)
        Shape parameters; the effects' start values if left out.
    dead_zone : (n,)
        Below this |q̇| the sign changes gradually from −1 to 1, rad/s; zero if left out.

    For effects with memory the samples are one segment, in order, from its first one. Effects on
    the whole arm or on the measurement do not follow from the signals of one joint: models with
    such an effect are refused (use `lieid.symbolic`), or, with ``joint_effects_only``, the other
    effects are evaluated alone. All raise `ModelError` for arrays of the wrong shape or kind.
    """

    def __init__(
        self, model: Model, *, threads: int | None = None, lanes: int | None = None
    ) -> None:
        self.model = model
        self.functions = ModelFunctions(model)
        self.threads = default_threads() if threads is None else threads
        self._kernels = Kernels(self.functions, lanes)
        self._memory = Kernels(self.functions, lanes=1)
        self._evaluations: dict[str, batch_evaluation.Evaluation] = {}

    @property
    def n(self) -> int:
        """Number of joints."""
        return self.model.n

    def regressor(self, q: ArrayLike, dq: ArrayLike, ddq: ArrayLike, **call: Unpack[Call]) -> Array:
        """Return the full regressor Y (N, n, 10 n) of the rigid torque."""
        return self._evaluate("regressor", self._samples(q=q, dq=dq, ddq=ddq), call)

    def inverse_dynamics(
        self,
        q: ArrayLike,
        dq: ArrayLike,
        ddq: ArrayLike,
        parameters: ArrayLike,
        **call: Unpack[Call],
    ) -> Array:
        """Return the rigid torque (N, n) of link parameters, N·m."""
        values = self._samples(q=q, dq=dq, ddq=ddq) | self._links(parameters)
        return self._evaluate("inverse_dynamics", values, call)

    def mass_matrix(self, q: ArrayLike, parameters: ArrayLike, **call: Unpack[Call]) -> Array:
        """Return M(q) (N, n, n) of link parameters, kg·m²."""
        return self._evaluate("mass_matrix", self._samples(q=q) | self._links(parameters), call)

    def gravity(self, q: ArrayLike, parameters: ArrayLike, **call: Unpack[Call]) -> Array:
        """Return G(q) (N, n) of link parameters, N·m."""
        return self._evaluate("gravity", self._samples(q=q) | self._links(parameters), call)

    def jacobian(self, q: ArrayLike, **call: Unpack[Call]) -> Array:
        """Return the tool's Jacobian (N, 6, n), [ω; v] in base axes."""
        return self._evaluate("jacobian", self._samples(q=q), call)

    def base_regressor(
        self, q: ArrayLike, dq: ArrayLike, ddq: ArrayLike, **given: Unpack[EffectCall]
    ) -> Array:
        """Return Y_b (N, n, p): the kept columns of [Y, effect columns]."""
        return self._evaluate("base_regressor", self._signals(q, dq, ddq, given, False), given)

    def base_blocks(
        self,
        q: ArrayLike,
        dq: ArrayLike,
        ddq: ArrayLike,
        *,
        part: Part = "base_regressor",
        size: int | None = None,
        **signals: Unpack[EffectSignals],
    ) -> batch_evaluation.BaseBlocks:
        """See `base_regressor`; in blocks of ``size`` samples, by default fitting in cache.

        ``part`` is the whole, or the columns of link parameters or of effects.
        """
        values = self._samples(q=q, dq=dq, ddq=ddq)
        if part != "base_links":
            values = self._signals(q, dq, ddq, signals, True)
        return batch_evaluation.BaseBlocks(self._evaluation(part), values, size)

    def effect_columns(
        self,
        q: ArrayLike,
        dq: ArrayLike,
        ddq: ArrayLike,
        *,
        joint_effects_only: bool = False,
        **given: Unpack[EffectCall],
    ) -> Array:
        """Return the effects' columns (N, n, m), dropped ones included."""
        values = self._signals(q, dq, ddq, given, joint_effects_only)
        return self._evaluate("effect_columns", values, given)

    def effect_torque(
        self,
        q: ArrayLike,
        dq: ArrayLike,
        ddq: ArrayLike,
        coefficients: ArrayLike,
        *,
        joint_effects_only: bool = False,
        **given: Unpack[EffectCall],
    ) -> Array:
        """Return the torque of all effects (N, n) for linear ``coefficients`` (m,)."""
        values = self._signals(q, dq, ddq, given, joint_effects_only)
        width = len(self.model.columns)
        values["coefficients"] = _constants("coefficients", coefficients, width)
        return self._evaluate("effect_torque", values, given)

    def _signals(
        self,
        q: ArrayLike,
        dq: ArrayLike,
        ddq: ArrayLike,
        given: EffectSignals,
        joint_effects_only: bool,
    ) -> dict[str, Array]:
        """Return the motion with the other signals of effects."""
        labels = [p.label for p in self.model.placements if isinstance(p.effect, ArmEffect)]
        if labels and not joint_effects_only:
            raise ModelError(
                f"{', '.join(labels)}: effects on the whole arm or on the measurement do not "
                "follow from the signals of one joint; use lieid.symbolic, or pass "
                "joint_effects_only=True where the function takes it"
            )
        unknown = given.keys() - EffectCall.__annotations__.keys()
        if unknown:
            raise TypeError(f"unexpected keyword argument {sorted(unknown)[0]!r}")
        own: dict[str, Any] = {name: x for name, x in given.items() if x is not None}
        values = self._samples(q=q, dq=dq, ddq=ddq)
        count = len(values["q"])
        for name, default in (
            ("shapes", self.model.initial_shapes),
            ("dead_zone", np.zeros(self.n)),
        ):
            values[name] = _constants(name, own.get(name, default), len(default))
        for name in ("load", "temperature", "command_error"):
            if name in own:
                values[name] = samples(name, own[name], self.n, count)
        if "time" in own:
            time = _real("time", own["time"])
            if time.shape not in ((count,), (count, 1)):
                raise ModelError(f"time: shape {time.shape}; expected ({count},)")
            values["time"] = time.reshape(count, 1)
        if self.model.states:
            values["states"] = batch_evaluation.states_along(self._memory, values)
        return values

    def _samples(self, **signals: ArrayLike) -> dict[str, Array]:
        """Check signals (N, n) of equal N."""
        values: dict[str, Array] = {}
        count = None
        for name, signal in signals.items():
            values[name] = samples(name, signal, self.n, count)
            count = len(values[name])
        return values

    def _links(self, parameters: ArrayLike) -> dict[str, Array]:
        return {"parameters": _constants("parameters", parameters, 10 * self.n)}

    def _evaluate(
        self, name: str, values: Mapping[str, Array], call: Call | EffectCall | None = None
    ) -> Array:
        """Evaluate a function; matrices that are columns become vectors."""
        given: Mapping[str, Any] = call or {}
        evaluation, threads = self._evaluation(name), given.get("threads")
        rows, columns = evaluation.layout.shape
        shape = (rows,) if name in _VECTORS else (rows, columns)
        result = _output(given.get("out"), (len(values["q"]), *shape))
        apart = {k: v.copy() if np.may_share_memory(v, result) else v for k, v in values.items()}
        matrices = result[:, :, None] if name in _VECTORS else result
        evaluation.bind(apart).dense(matrices, self.threads if threads is None else threads)
        return result

    def _evaluation(self, name: str) -> batch_evaluation.Evaluation:
        if name not in self._evaluations:
            starts, shape = self._extent(name)
            # a model without effects has no columns of theirs
            used = {part: first for part, first in starts.items() if first < shape[1]}
            self._evaluations[name] = batch_evaluation.evaluation_of(
                self._kernels, list(used), list(used.values()), shape
            )
        return self._evaluations[name]

    def _extent(self, name: str) -> tuple[dict[str, int], tuple[int, int]]:
        """Return the first column of each part by its name, and the whole matrix's shape."""
        n = self.n
        if name in _PARTS:
            kept = self.model.base.kept
            first = {"base_regressor": 0, "base_effects": int(np.sum(kept < 10 * n))}
            return {part: first[part] for part in _PARTS[name]}, (n, len(kept))
        shapes = {
            "regressor": (n, 10 * n), "effect_columns": (n, len(self.model.columns)),
            "mass_matrix": (n, n), "jacobian": (6, n),
        }  # fmt: skip
        return {name: 0}, shapes.get(name, (n, 1))


def default_threads() -> int:
    """Return $LIEID_THREADS (1 to 9999), else two, or one if only one processor may be used."""
    stated = os.environ.get("LIEID_THREADS", "")
    if re.fullmatch("[1-9][0-9]{0,3}", stated):
        return int(stated)
    return min(2, len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else 2)


def samples(name: str, values: ArrayLike, width: int, count: int | None = None) -> Array:
    """Return values (N, width) as float64, of any strides; ``count`` is the N that is expected."""
    array = _real(name, values)
    if array.ndim != 2 or array.shape[1] != width or count not in (None, len(array)):
        rows = "N" if count is None else str(count)
        raise ModelError(f"{name}: shape {array.shape}; expected ({rows}, {width})")
    return array


def _constants(name: str, values: ArrayLike, width: int) -> Array:
    """Return values (width,) that are the same for every sample as contiguous float64."""
    array = _real(name, values)
    if array.shape != (width,):
        raise ModelError(f"{name}: shape {array.shape}; expected ({width},)")
    return np.ascontiguousarray(array)


def _output(out: object, shape: tuple[int, ...]) -> Array:
    """Return the array to write to: ``out`` if it fits, a new one if it is None."""
    if out is None:
        return np.empty(shape)
    if not isinstance(out, np.ndarray):
        raise ModelError(f"out: {type(out).__name__}; expected an array of float64")
    if out.dtype != np.float64:
        raise ModelError(f"out: dtype {out.dtype}; expected float64")
    if out.shape != shape:
        raise ModelError(f"out: shape {out.shape}; expected {shape}")
    if not (out.flags.c_contiguous and out.flags.aligned and out.flags.writeable):
        raise ModelError("out: expected a C-contiguous, writable array")
    return out


def _real(name: str, values: ArrayLike) -> Array:
    if isinstance(values, np.ndarray) and values.dtype is _FLOAT and values.flags.aligned:
        return values
    try:
        array = np.asarray(values)
    except ValueError as error:  # rows of different lengths
        raise ModelError(f"{name}: {error}") from None
    if array.dtype.kind not in "fiub":
        raise ModelError(f"{name}: dtype {array.dtype}; expected real numbers")
    return np.require(array, np.float64, "A")
