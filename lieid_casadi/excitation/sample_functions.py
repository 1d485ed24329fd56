"""Functions of one motion sample, compiled, and the torque of a fit as such a function."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Protocol, cast

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from lieid_casadi.arrays import Array
from lieid_casadi.compiled.batch_evaluation import evaluation_of_one
from lieid_casadi.dynamics.lie import Motion
from lieid_casadi.errors import ExcitationError
from lieid_casadi.excitation.trajectory import MotionSamples
from lieid_casadi.expressions.model_functions import sparse_function
from lieid_casadi.expressions.symbolic import FittedModel
from lieid_casadi.expressions.torque import TorqueExpressions, Values
from lieid_casadi.model import Model, as_model
from lieid_casadi.robot.robot import Robot


class SampleKernel:
    """A sparse matrix function of q, dq, ddq per sample, compiled; by CasADi without a compiler.

    Sines and cosines of q are inputs of their own. Further inputs (w,) have names, and are given
    per sample as (N, w). The function's name is unique in a problem.
    """

    def __init__(
        self, name: str, symbols: Motion, matrix: ca.SX, further: Mapping[str, ca.SX] | None = None
    ) -> None:
        inputs = vars(symbols) | dict(further or {})
        sparse = sparse_function(name, list(inputs.values()), list(inputs), matrix)
        self._evaluation = evaluation_of_one(name, sparse)

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
        return self._evaluation.layout.shape

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


def reverse_derivative(values: ca.SX, seed: ca.SX, symbols: Motion) -> ca.SX:
    """Return seedᵀ·∂values/∂(q, dq, ddq) (3 n, 1) by reverse differentiation."""
    s = symbols
    gradient = ca.jtimes(values, ca.vertcat(*vars(s).values()), seed, True)
    q, sine, cosine, dq, ddq = ca.vertsplit(gradient, s.q.size1())
    return ca.vertcat(q + sine * s.cos - cosine * s.sin, dq, ddq)


def motion_jacobian(values: ca.SX, symbols: Motion) -> ca.SX:
    """Return ∂values/∂(q, dq, ddq) (k, 3 n), sparse."""
    s = symbols
    q, sine, cosine = (ca.jacobian(values, x) for x in (s.q, s.sin, s.cos))
    turning = ca.mtimes(sine, ca.diag(s.cos)) - ca.mtimes(cosine, ca.diag(s.sin))
    return ca.horzcat(q + turning, ca.jacobian(values, s.dq), ca.jacobian(values, s.ddq))


LEAST_SPEED = 1e-3  # rad/s; at which effects with memory slide
SIGN_WIDTH = 0.01  # of the velocity limit: half width of the smooth bounds of sgn(q̇)


class IdentifiedModel(FittedModel, Protocol):
    """What a design uses of a `lieid_casadi.Fit`."""

    @property
    def covariance(self) -> Array:
        """Covariance (p + s, p + s) of base and shape parameters."""


@dataclass(frozen=True, eq=False)
class FittedArm:
    """The numbers of a fit that a design uses; picklable."""

    model: Model
    link_parameters: Array
    effect_coefficients: Array
    shapes: Array
    covariance_root: Array  # (p + s, r) F, with F·Fᵀ the covariance of base and shape parameters

    @classmethod
    def of(cls, fit: IdentifiedModel) -> FittedArm:
        """Return the numbers of a fit."""
        if not np.isfinite(fit.covariance).all():
            raise ExcitationError(
                "the covariance of the fit is not finite, so that its torque has no bound; "
                "identify with more data or fewer effects"
            )
        sizes, vectors = np.linalg.eigh(fit.covariance)
        return cls(
            fit.model, fit.link_parameters, fit.effect_coefficients, fit.shapes,
            vectors * np.sqrt(np.maximum(sizes, 0.0)),
        )  # fmt: skip

    def torque_columns(self, motion: Motion, sign: ca.SX, direction: ca.SX, time: ca.SX) -> ca.SX:
        """Return the torque and its derivatives by base and shape parameters (n, 1 + p + s).

        It is the torque that the drives deliver: effects on the whole arm are in it, effects on
        the measurement are not. ``sign`` (n,) takes the place of sgn(q̇). States of effects with
        memory are those of steady sliding in a ``direction`` from −1 to 1: after a reversal they
        lie between those of both. Effects of the temperature are at its mean in the recordings.
        """
        numbers = Values.numbers(self.link_parameters, self.effect_coefficients, self.shapes)
        shapes = ca.SX.sym("shapes", len(self.shapes))
        values = Values(numbers.parameters, numbers.effects, shapes, numeric=True)
        torque = TorqueExpressions(
            self.model, values, None, as_measured=False, payload=False, sign=sign, motion=motion
        )
        inverse = torque.loaded_torque
        every = ca.horzcat(inverse, torque.base_regressor, ca.jacobian(inverse, shapes))
        every = ca.substitute(every, torque.states, self._sliding_states(torque, direction))
        return ca.substitute(
            every,
            ca.vertcat(torque.load, torque.temperature, torque.time, shapes),
            ca.vertcat(torque.rigid_torque, ca.SX.zeros(self.model.n), time, numbers.shapes),
        )

    def _sliding_states(self, torque: TorqueExpressions, direction: ca.SX) -> ca.SX:
        """Return the states (S,) of effects with memory in steady sliding.

        Their rates are affine in the states; the states at which the rates vanish forward and
        backward are joined linearly. Where they are larger in slow sliding (the deflection of
        LuGre's bristles), those are taken: they last for a part of the width after a reversal.
        """
        states, dq = torque.states, torque.motion.dq
        if not states.size1():
            return states
        rates = torque.state_rates
        offset = ca.substitute(rates, states, ca.SX.zeros(states.shape))
        steady = -offset / ca.diag(ca.jacobian(rates, states))
        slow = LEAST_SPEED * ca.SX.ones(dq.shape)
        speed = ca.fabs(dq) + slow
        forward = ca.fmax(*(ca.substitute(steady, dq, v) for v in (speed, slow)))
        backward = ca.fmin(*(ca.substitute(steady, dq, -v) for v in (speed, slow)))
        return (forward + backward) / 2 + (forward - backward) / 2 * direction


def shapes_of(model: Model, fit: FittedArm | None) -> Array:
    """Return the shape parameters (s,) of a model: those of the fit by label, or initial ones."""
    fitted: dict[str, float] = {}
    if fit is not None:
        labels = (shape.label for shape in fit.model.shapes)
        fitted = dict(zip(labels, fit.shapes.tolist(), strict=True))
    return np.array([fitted.get(shape.label, shape.initial) for shape in model.shapes])


def load_parameters(model: Model, fit: FittedArm | None) -> Array:
    """Return the link parameters (10 n,) whose torque is the load of friction."""
    return model.robot.link_parameters if fit is None else fit.link_parameters


def model_and_fit(source: Model | Robot | IdentifiedModel) -> tuple[Model, FittedArm | None]:
    """Return the model of a fit with the fit's numbers, or a model alone."""
    if not isinstance(source, Model | Robot) and hasattr(source, "covariance"):
        return source.model, FittedArm.of(source)
    return as_model(cast(Model, source)), None
