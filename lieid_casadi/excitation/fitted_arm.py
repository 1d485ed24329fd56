"""What a design uses of a fit: identified parameters, and their covariance."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol, cast

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from lieid_casadi.dynamics.lie import Motion
from lieid_casadi.errors import ExcitationError
from lieid_casadi.expressions.symbolic import FittedModel
from lieid_casadi.expressions.torque import TorqueExpressions, Values
from lieid_casadi.model import Model, as_model
from lieid_casadi.robot.robot import Robot

Array = NDArray[np.float64]
LEAST_SPEED = 1e-3  # rad/s; at which effects with memory slide


class IdentifiedModel(FittedModel, Protocol):
    """What a design uses of a `lieid_casadi.Fit`."""

    @property
    def covariance(self) -> Array:
        """Covariance (p + s, p + s) of base and shape parameters."""


@dataclass(frozen=True, eq=False)
class FittedArm:
    """The numbers of a fit that a design uses; picklable.

    Attributes
    ----------
    model : Model
    link_parameters : (10 n,)
    effect_coefficients : (m,)
    shapes : (s,)
    covariance_root : (p + s, r)
        F with F·Fᵀ the covariance of base and shape parameters.
    """

    model: Model
    link_parameters: Array
    effect_coefficients: Array
    shapes: Array
    covariance_root: Array

    @classmethod
    def of(cls, fit: IdentifiedModel) -> FittedArm:
        """Return the numbers of a fit.

        Raises
        ------
        ExcitationError
            The covariance is not finite, so that the torque has no bound.
        """
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
        the measurement are not. The states of effects with memory are those of steady sliding;
        effects of the temperature are at the mean temperature of the recordings.

        Parameters
        ----------
        motion : Motion
            Symbols q, q̇, q̈ (n,).
        sign : (n,)
            In place of sgn(q̇).
        direction : SX
            Of the sliding, −1 to 1, for effects with memory: after a reversal their states lie
            between those of both directions.
        time : SX
            Symbol of the time, s.
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
    """Return the model of a fit with the fit's numbers, or a model alone.

    Raises
    ------
    ModelError
        It is neither a model, nor a robot, nor a fit.
    """
    if not isinstance(source, Model | Robot) and hasattr(source, "covariance"):
        return source.model, FittedArm.of(source)
    return as_model(cast(Model, source)), None
