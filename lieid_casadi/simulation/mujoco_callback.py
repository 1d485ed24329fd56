"""The exact torque of a fit's effects as a passive force in MuJoCo."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import casadi as ca
import numpy as np

import lieid_casadi.expressions.symbolic as expressions
from lieid_casadi.errors import ModelError
from lieid_casadi.expressions.model_functions import ramp
from lieid_casadi.identification.fit import Fit

WIDTH = 0.02  # rad/s, half width of the range in which the sign of the velocity is smooth


def mujoco_callback(fit: Fit, model: Any, *, width: float = WIDTH) -> Callable[[Any, Any], None]:
    """Return a function for ``mujoco.set_mjcb_passive`` that makes friction that of the fit.

    It adds the difference between the torque of the fit's effects on single joints and what an
    exported model has for them: damping, frictionloss and the spring of an offset. Friction at
    rest remains that of frictionloss, which can hold a joint.

    ``fit``: from which the model was exported; ``model``: the model of ``lieid export --to mjcf``;
    ``width``: half width, rad/s, of the range in which the sign of the velocity is smooth.
    Raises `ModelError`: another number of joints than the fit's, or an effect with memory.

    Examples
    --------
    .. code-block:: python

        model = mujoco.MjModel.from_xml_path("arm/arm.xml")
        mujoco.set_mjcb_passive(lieid_casadi.simulation.mujoco_callback(fit, model))
    """
    n = fit.model.n
    if model.nu != n:
        raise ModelError(f"the MuJoCo model has {model.nu} actuators; the fit has {n} joints")
    if fit.model.states:
        raise ModelError(
            f"{fit.model.states[0].label}: effects with memory have no passive force; simulate the "
            "fit (lieid simulate), or identify without this effect"
        )
    friction = expressions.symbolic(fit, smooth_velocity=width, allow_indefinite=True).friction
    names = friction.name_in()
    fixed = {
        "temperature": fit.temperature_mean if fit.temperature_mean is not None else np.zeros(n)
    }
    speed = ca.SX.sym("dq", n)
    smooth_sign = ca.Function("sign", [speed], [ramp(speed, ca.SX(width))])
    joints = model.actuator_trnid[:, 0]  # beside joints of plays
    angles, speeds = model.jnt_qposadr[joints], model.jnt_dofadr[joints]
    damping = model.dof_damping[speeds] - _drive_damping(fit)
    loss, stiffness = model.dof_frictionloss[speeds], model.jnt_stiffness[joints]
    rest = model.qpos_spring[angles]

    def add(_: Any, data: Any) -> None:
        q, dq = data.qpos[angles], data.qvel[speeds]
        signals = {"q": q, "dq": dq, "time": data.time, **fixed}
        if "load" in names:
            signals["load"] = fit.compiled.inverse_dynamics(
                q[None], dq[None], data.qacc[speeds][None], fit.link_parameters
            )[0]
        exact = friction(*(signals[name] for name in names)).full()[:, 0]
        simulated = damping * dq + loss * smooth_sign(dq).full()[:, 0] + stiffness * (q - rest)
        data.qfrc_passive[speeds] -= exact - simulated

    return add


def _drive_damping(fit: Fit) -> Any:
    """Return the damping (n,) that belongs to servos and not to the arm's friction."""
    laws = fit.model.robot.drives
    if laws is None:
        return np.zeros(fit.model.n)
    return np.array([law.damping if np.isfinite(law.proportional_limit) else 0.0 for law in laws])
