"""Functions of the rigid arm on batches of samples."""

from __future__ import annotations

from numpy.typing import ArrayLike

from lieid_casadi.arrays import Array
from lieid_casadi.compiled.batch_functions import BatchFunctions


class RigidFunctions(BatchFunctions):
    """The rigid dynamics and kinematics of a model; `Compiled` adds its effects."""

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

        ``q``, ``dq``, ``ddq`` (N, n): rad, rad/s, rad/s²; ``out`` (N, n, 10 n): array to write to;
        ``threads``: threads for this call.
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

        ``q``, ``dq`` (N, n): rad, rad/s; ``dq_r``, ``ddq_r`` (N, n): rad/s, rad/s²; ``out`` (N, n,
        10 n): array to write to; ``threads``: threads for this call.
        """
        values = self._samples(q=q, dq=dq, dq_r=dq_r, ddq_r=ddq_r)
        return self._matrix("slotine_li_regressor", values, out, threads)

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

        ``q``, ``dq``, ``ddq`` (N, n): rad, rad/s, rad/s²; ``parameters`` (10 n,): link parameters;
        ``out`` (N, n): array to write to; ``threads``: threads for this call.
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

        ``q`` (N, n): rad; ``parameters`` (10 n,): link parameters; ``out`` (N, n, n): array to
        write to; ``threads``: threads for this call.
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

        ``q``, ``dq`` (N, n): rad, rad/s; ``parameters`` (10 n,): link parameters; ``out`` (N, n,
        n): array to write to; ``threads``: threads for this call.
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

        ``q`` (N, n): rad; ``parameters`` (10 n,): link parameters; ``out`` (N, n): array to write
        to; ``threads``: threads for this call.
        """
        values = self._samples(q=q) | self._links(parameters)
        return self._vector("gravity", values, out, threads)

    def jacobian(
        self, q: ArrayLike, *, out: Array | None = None, threads: int | None = None
    ) -> Array:
        """Return the tool's Jacobian (N, 6, n), [ω; v] in base axes.

        ``q`` (N, n): rad; ``out`` (N, 6, n): array to write to; ``threads``: threads for this call.
        """
        return self._matrix("jacobian", self._samples(q=q), out, threads)
