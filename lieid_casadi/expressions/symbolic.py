"""The model of an arm as CasADi functions, for optimal control and downstream code generation."""

from __future__ import annotations

from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike

from lieid_casadi.arrays import Array
from lieid_casadi.errors import ModelError
from lieid_casadi.expressions.inputs import Values
from lieid_casadi.expressions.symbolic_dynamics import SymbolicDynamics
from lieid_casadi.expressions.torque import TorqueExpressions
from lieid_casadi.model import Model
from lieid_casadi.robot.robot import Robot


class FittedModel(Protocol):
    """What `symbolic` uses of a fit."""

    @property
    def model(self) -> Model:
        """The model that was fitted."""

    @property
    def link_parameters(self) -> Array:
        """Link parameters (10 n,)."""

    @property
    def effect_coefficients(self) -> Array:
        """Linear coefficients of the effects (m,)."""

    @property
    def shapes(self) -> Array:
        """Shape parameters (s,)."""

    @property
    def temperature_mean(self) -> Array | None:
        """Mean temperature (n,) of the training recordings, °C."""


def symbolic(
    source: Robot | Model | FittedModel,
    *,
    smooth_velocity: ArrayLike | None = None,
    as_measured: bool = False,
    payload: bool = False,
    free_parameters: bool = False,
    allow_indefinite: bool = False,
) -> SymbolicDynamics:
    """Return the dynamics of an arm as named CasADi functions.

    Parameters
    ----------
    source : Robot, Model or Fit
        A robot: its nominal link parameters are numbers, there are no effects. A model: link
        parameters, effect coefficients and shape parameters are inputs. A fit: they are the
        fit's numbers.
    smooth_velocity : float or (n,), optional
        Half width w in rad/s (m/s) of the range in which sgn(q̇) is replaced by a polynomial of
        degree 7, twice continuously differentiable at ±w, so that derivatives are finite at rest.
        None: sgn(q̇) itself, with sgn(0) = 0.
    as_measured : bool
        Whether the torque is what the sensor reads, with the model's measurement effects (gain,
        encoder offset), instead of what the drives deliver. The positions are then those that the
        encoders read. Effects on the whole arm (payload, tilt, wrench) are always included.
    payload : bool
        Whether a body at the tool is a further input: its ten link parameters in the tool frame.
    free_parameters : bool
        With a fit: whether link parameters, coefficients and shapes are inputs, as with a model.
    allow_indefinite : bool
        Whether forward dynamics are given although the mass matrix is not positive definite in
        some poses within the joint limits.

    Returns
    -------
    SymbolicDynamics

    Raises
    ------
    RobotError
        Naming the links of a robot whose inertia is not stated.
    ModelError
        An effect cannot be evaluated at one instant (delay, elasticity) and ``as_measured`` asks
        for it.

    Examples
    --------
    >>> import lieid_casadi as lieid
    >>> arm = lieid.symbolic(lieid.robots.two_link())
    >>> arm.inverse_dynamics
    Function(inverse_dynamics:(q[2],dq[2],ddq[2])->(tau[2]) SXFunction)
    """
    if isinstance(source, Robot):
        model = Model(source)
        values = Values.numbers(source.link_parameters, np.zeros(0), np.zeros(0))
    elif isinstance(source, Model):
        model, values = source, Values.symbols(source)
    else:
        model = source.model
        values = (
            Values.symbols(model, source.temperature_mean)
            if free_parameters
            else Values.numbers(
                source.link_parameters,
                source.effect_coefficients,
                source.shapes,
                source.temperature_mean,
            )
        )
    width = None
    if smooth_velocity is not None:
        width = np.broadcast_to(np.asarray(smooth_velocity, dtype=float), (model.n,))
        if not (np.isfinite(width).all() and (width > 0.0).all()):
            raise ModelError(f"smooth_velocity: got {smooth_velocity}; expected rad/s above zero")
    torque = TorqueExpressions(model, values, width, as_measured=as_measured, payload=payload)
    remedy = "identify with --method feasible"
    if isinstance(source, Robot):
        remedy = "correct the inertias in the robot's description"
    return SymbolicDynamics(torque, allow_indefinite=allow_indefinite, remedy=remedy)
