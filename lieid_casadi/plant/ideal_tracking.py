"""True signals of the plant, and those of an arm that tracks a motion perfectly."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from lieid_casadi.arrays import Array, Mask
from lieid_casadi.plant.arm import Arm, Drive, rigid_torques, wrench_torque
from lieid_casadi.plant.effects import JointState

AT_REST = 1e-7  # rad/s; a filtered path has rounding errors at rest


@dataclass(frozen=True, eq=False)
class TrueMotion:
    """True signals at N instants: t (N,), all others (N, n). SI units.

    τ = rigid + smooth + dry + armature·motor_ddq holds sample by sample. Where a joint rested, came
    to rest or reversed within the step, its dry friction does not follow from the velocity.
    """

    t: Array
    q: Array  # of the links
    dq: Array
    ddq: Array
    motor_q: Array  # of the motors; they differ from those of the links at elastic joints
    motor_dq: Array
    motor_ddq: Array
    tau: Array  # that the drives deliver
    rigid: Array  # of the rigid arm, payload and tool wrench included
    dry: Array  # dry friction
    smooth: Array  # all other torques: viscous friction, offset, spring, ripple
    resting: Mask
    temperature: Array  # °C


def move_along(
    arm: Arm, t: ArrayLike, q: ArrayLike, dq: ArrayLike, ddq: ArrayLike, *, seed: int = 0
) -> TrueMotion:
    """Return the true signals of an arm along a given motion.

    Dry friction at rest is undetermined: during each rest of a joint it is a constant random
    fraction of its level that the seed determines. Times are (N,), the motion of the links (N, n).
    """
    t, q, dq, ddq = (np.asarray(x, dtype=float) for x in (t, q, dq, ddq))
    rigid = rigid_torques(arm.rigid_model(), q, dq, ddq) + _tool_torques(arm, q)
    motor_q, motor_dq, motor_ddq = _motors(arm, t, (q, dq, ddq), rigid)
    temperature = arm.thermal.at(t, arm.n)
    drive = Drive(arm)
    resting = np.abs(motor_dq) <= AT_REST
    sign = np.where(resting, 0.0, np.sign(motor_dq))
    resting &= ~drive.hysteretic
    state = JointState(t, motor_q, motor_dq, sign, rigid, temperature)
    level, smooth = drive.level(state), drive.smooth(state)
    direction = np.where(resting, _held(resting, seed), sign)
    if drive.hysteretic.any():
        direction[:, drive.hysteretic] = _hysteresis(drive, motor_q)[:, drive.hysteretic]
    dry = direction * level
    tau = rigid + smooth + dry + arm.armature * motor_ddq
    return TrueMotion(
        t, q, dq, ddq, motor_q, motor_dq, motor_ddq, tau, rigid, dry, smooth, resting, temperature
    )


def _tool_torques(arm: Arm, q: Array) -> Array:
    wrench = arm.tool_wrench
    if not wrench.any():
        return np.zeros_like(q)
    model = arm.rigid_model()
    data = model.createData()
    return np.array([wrench_torque(model, data, row, wrench) for row in q])


def _motors(
    arm: Arm, t: Array, link: tuple[Array, Array, Array], rigid: Array
) -> tuple[Array, Array, Array]:
    """Motor angle = link angle + τ/K and its derivatives, on the elastic joints."""
    elastic = arm.compliance > 0.0
    if not elastic.any():
        return link
    from scipy.interpolate import CubicSpline

    deflection = CubicSpline(t, rigid * arm.compliance)
    return link[0] + deflection(t), link[1] + deflection(t, 1), link[2] + deflection(t, 2)


def _held(resting: Mask, seed: int) -> Array:
    """Return the fraction of dry friction, −1 to 1, constant during each rest (N, n)."""
    random = np.random.default_rng([seed, 1])
    begins = np.diff(resting, axis=0, prepend=False) & resting
    held = np.zeros(resting.shape)
    for joint in range(resting.shape[1]):
        rest = np.cumsum(begins[:, joint])
        parts = random.uniform(-1, 1, int(rest[-1]) + 1)
        held[:, joint] = parts[rest]
    return held


def _hysteresis(drive: Drive, q: Array) -> Array:
    z = np.zeros_like(q)
    for k in range(1, q.shape[0]):
        z[k] = drive.next_hysteresis(z[k - 1], q[k] - q[k - 1])
    return z
