"""Torque of a fitted model at given samples, with every effect."""

from __future__ import annotations

from functools import lru_cache
from typing import TYPE_CHECKING

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike, NDArray

from lieid_casadi.dynamics.lie import Motion
from lieid_casadi.effects import ArmEffect
from lieid_casadi.errors import ModelError
from lieid_casadi.expressions.torque import ArmInstant, arm_effect_columns

if TYPE_CHECKING:
    from lieid_casadi.identification.fit import Fit

Array = NDArray[np.float64]


def sample_torque(
    fit: Fit,
    q: ArrayLike,
    dq: ArrayLike,
    ddq: ArrayLike,
    *,
    temperature: ArrayLike | None = None,
    time: ArrayLike | None = None,
) -> Array:
    """Return the torque (N, n) at samples; see `Fit.torque`.

    Parameters
    ----------
    fit : Fit
    q, dq, ddq : (N, n)
        rad, rad/s, rad/s² (m for a sliding joint).
    temperature : (N, n), optional
        °C.
    time : (N,), optional
        s.

    Raises
    ------
    ModelError
        A signal that an effect needs is not given, or an effect depends on the motion before the
        instant.
    """
    q, dq, ddq = (np.atleast_2d(np.asarray(x, dtype=float)) for x in (q, dq, ddq))
    _require_signals(fit, temperature, time)
    if temperature is not None and fit.temperature_mean is not None:
        temperature = np.asarray(temperature, dtype=float) - fit.temperature_mean
    load = fit.compiled.inverse_dynamics(q, dq, ddq, fit.link_parameters)
    joints = fit.compiled.friction(
        q,
        dq,
        ddq,
        fit.effect_coefficients,
        load=load,
        temperature=temperature,
        time=time,
        shapes=fit.shapes,
        joint_effects_only=True,
    )
    torque = np.asarray(load + joints)
    if not any(isinstance(p.effect, ArmEffect) for p in fit.model.placements):
        return torque
    change = _arm_effect_torque(fit)(*(x.T for x in (q, dq, ddq, load, torque)))
    return np.asarray(torque + change.full().T)


@lru_cache(maxsize=8)
def _arm_effect_torque(fit: Fit) -> ca.Function:
    """Return ``(q, dq, ddq, load, torque) -> change`` of effects not on single joints."""
    model = fit.model
    q, dq, ddq, load, torque = (
        ca.SX.sym(name, model.n) for name in ("q", "dq", "ddq", "load", "torque")
    )
    links = ca.SX(ca.DM(fit.link_parameters))
    coefficients = ca.SX(ca.DM(fit.effect_coefficients))
    arm = ArmInstant(model.robot, Motion.of(q, dq, ddq), links, links, load, torque)
    columns = [
        arm_effect_columns(model, arm, coefficients, measurement=measurement)
        for measurement in (False, True)
    ]
    change = ca.densify(ca.mtimes(columns[0] + columns[1], coefficients))
    return ca.Function("arm_effect_torque", [q, dq, ddq, load, torque], [change], {"cse": True})


def _require_signals(fit: Fit, temperature: ArrayLike | None, time: ArrayLike | None) -> None:
    for name, given in (("temperature", temperature), ("time", time)):
        needing = [p.label for p in fit.model.placements if name in p.effect.signals]
        if needing and given is None:
            raise ModelError(f"{', '.join(needing)}: expected {name}= beside the motion")
