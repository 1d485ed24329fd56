"""A serial arm from a MuJoCo model (extra ``[mujoco]``)."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lieid_casadi.errors import MissingDependency, RobotError
from lieid_casadi.robot.description import NOT_STATED, Joint, Limits, RobotDescription
from lieid_casadi.robot.drive import Drive
from lieid_casadi.robot.inertia import link_parameters, parameter_transport

Array = NDArray[np.float64]


def read_mjcf(path: str | Path, *, tip: str | None = None) -> RobotDescription:
    """Return the serial arm of a MuJoCo model, in its pose ``qpos0``.

    Bodies without joints move with their parents and add to their inertia. Position actuators
    become drives, and force ranges torque limits. Friction, armature, contacts and plays (joints
    without actuator on the axis of the joint before, in the same body) are not read: they are
    what an identification finds.

    Parameters
    ----------
    path : str or Path
        MJCF or a URDF that MuJoCo reads, with its assets beside it.
    tip : str, optional
        Body at which the chain ends; needed where the model branches.

    Raises
    ------
    MissingDependency
        mujoco is not installed.
    RobotError
        Not a model, no chain of hinges and slides, or several chains and no tip.
    """
    try:
        import mujoco
    except ImportError as error:
        raise MissingDependency(
            f"{path}: MuJoCo models need mujoco: pip install 'lieid-casadi[mujoco]'"
        ) from error
    try:
        model = mujoco.MjModel.from_xml_path(str(path))
    except (ValueError, OSError) as error:
        reason = " ".join(str(error).split())[:200]
        raise RobotError(f"{path}: not a MuJoCo model ({reason})") from error
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    chain = _chain(model, path, tip)
    joints = [_joint(model, data, body, _rigid_with(model, body)) for body in chain]
    name = model.names[: model.names.find(b"\0")].decode(errors="replace")
    return RobotDescription(
        name=name or "robot",
        joints=tuple(joints),
        gravity=np.array(model.opt.gravity, dtype=float),
    )


def _chain(model: Any, path: str | Path, tip: str | None) -> list[int]:
    """Return the bodies with joints from the base to the tip."""
    moving = [b for b in range(1, model.nbody) if model.body_jntnum[b]]
    if not moving:
        raise RobotError(f"{path}: found no joints, expected hinges or slides")
    if tip is not None:
        names = [model.body(b).name for b in range(model.nbody)]
        if tip not in names:
            raise RobotError(f"{path}: no body {tip!r}; expected one of {', '.join(names[1:])}")
        end = names.index(tip)
    else:
        parents = {_moving_parent(model, b) for b in moving}
        ends = [b for b in moving if b not in parents]
        if len(ends) > 1:
            found = ", ".join(model.body(b).name for b in ends)
            raise RobotError(
                f"{path}: the model branches into chains that end at {found}; expected tip= "
                "(--tip BODY)"
            )
        end = ends[0]
    chain = [] if not model.body_jntnum[end] else [end]
    while (end := _moving_parent(model, end)) > 0:
        chain.append(end)
    for body in chain:
        first = model.body_jntadr[body]
        own = range(first, first + model.body_jntnum[body])
        kinds = [int(model.jnt_type[k]) for k in own if not _is_play(model, first, k)]
        if kinds not in ([2], [3]):  # slide, hinge
            raise RobotError(
                f"{path}: body {model.body(body).name!r} has {len(kinds)} joints or one that is "
                "neither a hinge nor a slide; expected one hinge or slide per body"
            )
    return chain[::-1]


def _is_play(model: Any, first: int, joint: int) -> bool:
    """Return whether a joint has the axis of its body's first one and no actuator."""
    places = (model.jnt_axis, model.jnt_pos, model.jnt_type)
    same = all(np.allclose(place[first], place[joint]) for place in places)
    moved = model.actuator_trnid[model.actuator_trntype == 0, 0]
    return joint != first and same and joint not in moved


def _moving_parent(model: Any, body: int) -> int:
    """Return the next body with joints towards the base, 0 for none."""
    parent = int(model.body_parentid[body])
    while parent and not model.body_jntnum[parent]:
        parent = int(model.body_parentid[parent])
    return parent


def _rigid_with(model: Any, body: int) -> list[int]:
    """Return a body and those that are rigidly attached to it."""
    found = [body]
    for other in range(body + 1, model.nbody):
        if model.body_parentid[other] in found and not model.body_jntnum[other]:
            found.append(other)
    return found


def _joint(model: Any, data: Any, body: int, bodies: list[int]) -> Joint:
    """Return the joint of a body."""
    index = int(model.body_jntadr[body])
    home = _pose(data, body)
    axis, anchor = np.array(data.xaxis[index]), np.array(data.xanchor[index])
    hinge = int(model.jnt_type[index]) == 3
    screw = np.concatenate([axis, -np.cross(axis, anchor)] if hinge else [np.zeros(3), axis])
    total = np.zeros(10)
    for other in bodies:
        between = np.asarray(np.linalg.solve(home, _pose(data, other)))
        turn = _rotation(model.body_iquat[other])
        inertia = turn @ np.diag(model.body_inertia[other]) @ turn.T
        own = link_parameters(float(model.body_mass[other]), model.body_ipos[other], inertia)
        total += parameter_transport(between) @ own
    low, high = model.jnt_range[index] if model.jnt_limited[index] else (NOT_STATED, NOT_STATED)
    zero = float(model.qpos0[model.jnt_qposadr[index]])
    drive, torque = _drive(model, index)
    return Joint(
        name=model.joint(index).name or f"joint{index + 1}",
        screw=screw,
        home=home,
        limits=Limits(float(low) - zero, float(high) - zero, torque=torque),
        link=total if total[0] > 0.0 else None,
        link_name=model.body(body).name,
        drive=drive,
    )


def _drive(model: Any, joint: int) -> tuple[Drive | None, float]:
    """Return the control law of a joint's position actuator, and the torque limit, N·m."""
    for k in range(model.nu):
        if int(model.actuator_trntype[k]) != 0 or int(model.actuator_trnid[k, 0]) != joint:
            continue
        limited = bool(model.actuator_forcelimited[k])
        force = float(model.actuator_forcerange[k, 1]) if limited else math.nan
        gain, bias = float(model.actuator_gainprm[k, 0]), model.actuator_biasprm[k]
        if bias[1] < 0.0 and np.isclose(gain, -bias[1]):
            return Drive(stiffness=gain, damping=max(-float(bias[2]), 0.0)), force
        if math.isnan(force) and model.actuator_ctrllimited[k]:
            force = float(model.actuator_ctrlrange[k, 1]) * gain
        return None, force
    return None, NOT_STATED


def _pose(data: Any, body: int) -> Array:
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = data.xmat[body].reshape(3, 3), data.xpos[body]
    return pose


def _rotation(quaternion: Array) -> Array:
    from scipy.spatial.transform import Rotation

    w, x, y, z = quaternion
    return np.asarray(Rotation.from_quat([x, y, z, w]).as_matrix())
