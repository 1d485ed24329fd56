"""Batch evaluation of a model: NumPy in, NumPy out."""

from __future__ import annotations

from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lieid_casadi.errors import ModelError
from lieid_casadi.functions import ModelFunctions, SparseFunction
from lieid_casadi.model import Model

Array = NDArray[np.float64]
BLOCK = 4096  # samples evaluated at once; bounds the memory of intermediate results


def compile(model: Model) -> Compiled:
    """Return the model's functions for batches of samples.

    Examples
    --------
    >>> import lieid_casadi as lieid
    >>> arm = lieid.compile(lieid.Model(lieid.robots.two_link(), effects=["viscous"]))
    >>> arm.regressor([[0.1, 0.2]], [[0.0, 0.0]], [[0.0, 0.0]]).shape
    (1, 2, 20)
    """
    return Compiled(model)


class Compiled:
    """A model's functions on arrays of N samples: q, dq, ddq (N, n) in rad and seconds."""

    def __init__(self, model: Model) -> None:
        self.model = model
        self.functions = ModelFunctions(model)

    def regressor(self, q: ArrayLike, dq: ArrayLike, ddq: ArrayLike) -> Array:
        """Return the full regressor Y (N, n, 10 n) of the rigid torque."""
        return self._dense(self.functions.regressor, *self._motion(q, dq, ddq))

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
            |q̇| below it counts as rest, rad/s; zero if left out.
        """
        rigid = self.rigid_base_regressor(q, dq, ddq)
        effects = self.effect_columns(
            q, dq, ddq, load=load, temperature=temperature, time=time, shapes=shapes,
            dead_zone=dead_zone,
        )  # fmt: skip
        kept = self.model.base.kept - 10 * self.model.n
        rigid[:, :, kept >= 0] = effects[:, :, kept[kept >= 0]]
        return rigid

    def rigid_base_regressor(self, q: ArrayLike, dq: ArrayLike, ddq: ArrayLike) -> Array:
        """Return Y_b (N, n, p) with zeros in the effects' columns."""
        return self._dense(self.functions.base_regressor, *self._motion(q, dq, ddq))

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
    ) -> Array:
        """Return the effects' columns (N, n, m), dropped ones included; see `base_regressor`."""
        positions = self._samples("q", q)
        samples, n = positions.shape
        inputs = [
            positions,
            self._samples("dq", dq, samples),
            self._samples("ddq", ddq, samples),
            np.zeros((samples, n)) if load is None else self._samples("load", load, samples),
            np.zeros((samples, n))
            if temperature is None
            else self._samples("temperature", temperature, samples),
            np.zeros((samples, 1)) if time is None else np.reshape(time, (samples, 1)),
            self.model.initial_shapes if shapes is None else np.asarray(shapes, dtype=float),
            np.zeros(n) if dead_zone is None else np.asarray(dead_zone, dtype=float),
        ]
        return self._dense(self.functions.effect_columns, *inputs)

    def inverse_dynamics(
        self, q: ArrayLike, dq: ArrayLike, ddq: ArrayLike, parameters: ArrayLike
    ) -> Array:
        """Return the rigid torque (N, n) of link parameters (10 n,), N·m."""
        motion = self._motion(q, dq, ddq)
        return self._dense(self.functions.inverse_dynamics, *motion, self._links(parameters))[:, :, 0]

    def friction(
        self, q: ArrayLike, dq: ArrayLike, ddq: ArrayLike, coefficients: ArrayLike, **signals: ArrayLike
    ) -> Array:
        """Return the torque of all effects (N, n) for linear coefficients (m,)."""
        columns = self.effect_columns(q, dq, ddq, **signals)
        return np.asarray(columns @ np.asarray(coefficients, dtype=float))

    def mass_matrix(self, q: ArrayLike, parameters: ArrayLike) -> Array:
        """Return M(q) (N, n, n), kg·m²."""
        return self._dense(self.functions.mass_matrix, *self._pose(q), self._links(parameters))

    def coriolis_matrix(self, q: ArrayLike, dq: ArrayLike, parameters: ArrayLike) -> Array:
        """Return C(q, q̇) (N, n, n) with Ṁ − 2C skew-symmetric."""
        pose = self._pose(q)
        rates = self._samples("dq", dq, len(pose[0]))
        return self._dense(self.functions.coriolis_matrix, *pose, rates, self._links(parameters))

    def gravity(self, q: ArrayLike, parameters: ArrayLike) -> Array:
        """Return G(q) (N, n), N·m."""
        values = self._dense(self.functions.gravity, *self._pose(q), self._links(parameters))
        return values[:, :, 0]

    def jacobian(self, q: ArrayLike) -> Array:
        """Return the tool's Jacobian (N, 6, n), [ω; v] in base axes."""
        return self._dense(self.functions.jacobian, *self._pose(q))

    @cached_property
    def n(self) -> int:
        """Number of joints."""
        return self.model.n

    def _samples(self, name: str, values: ArrayLike, samples: int | None = None) -> Array:
        array = np.asarray(values, dtype=np.float64)
        if array.ndim != 2 or array.shape[1] != self.n or samples not in (None, len(array)):
            rows = "N" if samples is None else str(samples)
            raise ModelError(f"{name}: shape {array.shape}; expected ({rows}, {self.n})")
        return array

    def _links(self, parameters: ArrayLike) -> Array:
        array = np.asarray(parameters, dtype=np.float64)
        if array.shape != (10 * self.n,):
            raise ModelError(f"parameters: shape {array.shape}; expected ({10 * self.n},)")
        return array

    def _pose(self, q: ArrayLike) -> tuple[Array, Array, Array]:
        positions = self._samples("q", q)
        return positions, np.sin(positions), np.cos(positions)

    def _motion(self, q: ArrayLike, dq: ArrayLike, ddq: ArrayLike) -> tuple[Array, ...]:
        pose = self._pose(q)
        samples = len(pose[0])
        return (*pose, self._samples("dq", dq, samples), self._samples("ddq", ddq, samples))

    def _dense(self, sparse: SparseFunction, *inputs: Array) -> Array:
        """Evaluate on every sample; inputs are (N, k) or, the same for all, (k,)."""
        samples = len(inputs[0])
        result = np.zeros((samples, *sparse.shape))
        for first in range(0, samples, BLOCK):
            rows = slice(first, min(first + BLOCK, samples))
            columns = [x[rows].T if x.ndim == 2 else x for x in inputs]
            values = np.asarray(sparse.function(*columns).full())
            result[rows, sparse.rows, sparse.columns] = values.T
        return result
