"""Batch evaluation of a model: NumPy in, NumPy out."""

from __future__ import annotations

from numpy.typing import ArrayLike

from lieid_casadi.arrays import Array
from lieid_casadi.compiled import array_checks
from lieid_casadi.compiled.base_regressor_blocks import BaseBlocks
from lieid_casadi.compiled.rigid_functions import RigidFunctions
from lieid_casadi.effects import ArmEffect
from lieid_casadi.errors import ModelError
from lieid_casadi.model import Model, as_model
from lieid_casadi.robot import Robot


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
    made = as_model(model)
    made.robot.require_numbers("compile")
    return Compiled(made, threads=threads, lanes=lanes)


class Compiled(RigidFunctions):
    """A model's functions on arrays of N samples: q, dq, ddq (N, n) in rad and seconds.

    Arrays may have any strides. ``out`` is a C-contiguous array of the result's shape to write to,
    ``threads`` the number of threads for this call. NaN in a sample gives NaN in that sample only;
    effects with memory hold their state there (`Effect.next_states`).
    Every method raises `ModelError` for arrays of the wrong shape or kind.

    Parameters
    ----------
    model : Model
    threads : int, optional
        Threads that share a large batch; two if left out.
    lanes : int, optional
        Samples per vector register; the most that the processor has if left out.
    """

    def base_regressor(
        self,
        q: ArrayLike,
        dq: ArrayLike,
        ddq: ArrayLike,
        *,
        load: ArrayLike | None = None,
        temperature: ArrayLike | None = None,
        time: ArrayLike | None = None,
        command_error: ArrayLike | None = None,
        shapes: ArrayLike | None = None,
        dead_zone: ArrayLike | None = None,
        out: Array | None = None,
        threads: int | None = None,
    ) -> Array:
        """Return Y_b (N, n, p): the kept columns of [Y, effect columns].

        Parameters
        ----------
        q, dq, ddq : (N, n)
            rad, rad/s, rad/s².
        load : (N, n), optional
            τ_load, N·m; zero if left out.
        temperature : (N, n), optional
            °C relative to the training mean; zero if left out.
        time : (N,), optional
            s; zero if left out.
        command_error : (N, n), optional
            Commanded minus measured position, rad; zero if left out.
        shapes : (s,), optional
            Shape parameters; the effects' start values if left out.
        dead_zone : (n,), optional
            Below this |q̇| the sign changes gradually from −1 to 1, rad/s; zero if left out.
        out : (N, n, p), optional
            Array to write to.
        threads : int, optional
            Threads for this call.

        Raises
        ------
        ModelError
            The model has effects on the whole arm or on the measurement.
        """
        self._require_joint_effects()
        motion = self._motion(q, dq, ddq)
        values = self._signals(motion, load, temperature, time, command_error, shapes, dead_zone)
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
            rad, rad/s, rad/s².
        out : (N, n, p), optional
            Array to write to.
        threads : int, optional
            Threads for this call.
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
        command_error: ArrayLike | None = None,
        shapes: ArrayLike | None = None,
        dead_zone: ArrayLike | None = None,
        size: int | None = None,
    ) -> BaseBlocks:
        """Return Y_b in blocks that fit in cache.

        Parameters
        ----------
        q, dq, ddq : (N, n)
            rad, rad/s, rad/s².
        load, temperature, time, command_error, shapes, dead_zone : optional
            As for `base_regressor`.
        size : int, optional
            Samples per block; as many as half a second-level cache holds if left out.
        """
        motion = self._motion(q, dq, ddq)
        values = self._signals(motion, load, temperature, time, command_error, shapes, dead_zone)
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
        command_error: ArrayLike | None = None,
        shapes: ArrayLike | None = None,
        dead_zone: ArrayLike | None = None,
        out: Array | None = None,
        threads: int | None = None,
        joint_effects_only: bool = False,
    ) -> Array:
        """Return the effects' columns (N, n, m), dropped ones included.

        For effects with memory the samples are one segment, in order, from its first one.

        Parameters
        ----------
        q, dq, ddq : (N, n)
            rad, rad/s, rad/s².
        load, temperature, time, command_error, shapes, dead_zone : optional
            As for `base_regressor`.
        out : (N, n, m), optional
            Array to write to.
        threads : int, optional
            Threads for this call.
        joint_effects_only : bool
            Whether effects on the whole arm or on the measurement are left out; otherwise a model
            that has any is refused, because they do not follow from the signals of one joint.

        Raises
        ------
        ModelError
            The model has effects on the whole arm or on the measurement; use `Fit.torque`.
        """
        if not joint_effects_only:
            self._require_joint_effects()
        motion = self._motion(q, dq, ddq)
        values = self._signals(motion, load, temperature, time, command_error, shapes, dead_zone)
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
        command_error: ArrayLike | None = None,
        shapes: ArrayLike | None = None,
        dead_zone: ArrayLike | None = None,
        out: Array | None = None,
        threads: int | None = None,
        joint_effects_only: bool = False,
    ) -> Array:
        """Return the torque of all effects (N, n) for linear coefficients (m,).

        Parameters
        ----------
        q, dq, ddq : (N, n)
            rad, rad/s, rad/s².
        coefficients : (m,)
            Linear coefficients.
        load, temperature, time, command_error, shapes, dead_zone : optional
            As for `base_regressor`.
        out : (N, n), optional
            Array to write to.
        threads : int, optional
            Threads for this call.
        joint_effects_only : bool
            Whether effects on the whole arm or on the measurement are left out; otherwise a model
            that has any is refused, because they do not follow from the signals of one joint.

        Raises
        ------
        ModelError
            The model has effects on the whole arm or on the measurement; use `Fit.torque`.
        """
        if not joint_effects_only:
            self._require_joint_effects()
        motion = self._motion(q, dq, ddq)
        values = self._signals(motion, load, temperature, time, command_error, shapes, dead_zone)
        width = len(self.model.columns)
        values["coefficients"] = array_checks.constants("coefficients", coefficients, width)
        return self._vector("friction", values, out, threads)

    def _require_joint_effects(self) -> None:
        labels = [p.label for p in self.model.placements if isinstance(p.effect, ArmEffect)]
        if labels:
            raise ModelError(
                f"{', '.join(labels)}: effects on the whole arm or on the measurement do not "
                "follow from the signals of one joint; use Fit.torque or lieid.symbolic, or pass "
                "joint_effects_only=True where the function takes it"
            )
