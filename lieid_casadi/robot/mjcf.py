"""A serial arm from a MuJoCo model (extra ``[mujoco]``)."""

from __future__ import annotations

import math
import os
from collections.abc import Collection, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np

from lieid_casadi.arrays import Array
from lieid_casadi.errors import (
    LieidWarning,
    LockedBranchWarning,
    MissingMeshWarning,
    NotReadWarning,
    RobotError,
    of_extra,
)
from lieid_casadi.messages import names_text, reason_of
from lieid_casadi.robot.description import (
    MOST_JOINTS,
    NOT_STATED,
    Joint,
    Limits,
    RobotDescription,
    RobotSource,
    read_text,
)
from lieid_casadi.robot.drive import Drive
from lieid_casadi.robot.inertia import link_parameters, parameter_transport

#: Most copies that elements of a model may ask for, and most cells of a height field or texture:
#: MuJoCo makes them before it looks at anything else.
MOST_COPIES, MOST_CELLS = 10_000, 10_000_000
MOST_FILES = 200  # of a model and those that it includes or attaches
SLIDE, HINGE = 2, 3  # MuJoCo's types of joints
INTEGRATOR, NO_DYNAMICS = 1, 0  # MuJoCo's types of activation dynamics


def read_mjcf(
    path: str | Path, *, tip: str | None = None, lock: Sequence[str] = ()
) -> RobotDescription:
    """Return the serial arm of a MuJoCo model, whose angles are those of ``qpos``.

    Bodies without joints move with their parents and add to their inertia, as do branches off the
    chain to ``tip``, whose joints are locked at the first keyframe. Position actuators become
    drives, and force ranges torque limits. Friction, armature, contacts and plays (joints
    without actuator on the axis of the joint before, in the same body) are not read: they are
    what an identification finds. Springs, gravity compensation, fluids, constraints, tendons, other
    actuators and the dynamics of actuators are not read either, and named in the warnings. Meshes
    that are missing are left out.
    """
    with of_extra("mujoco", f"{path}: MuJoCo models need mujoco"):
        import mujoco
    files = _require_bounded(Path(path))
    try:
        spec = mujoco.MjSpec.from_file(str(path))
        missing = _without_appearance(spec, Path(path))
        model = spec.compile()
    except (ValueError, OSError) as error:
        raise RobotError(f"{path}: not a MuJoCo model ({reason_of(error)})") from error
    joints = [model.joint(k).name for k in range(model.njnt)]
    unknown = next((name for name in lock if name not in joints), None)
    if unknown is not None:
        raise RobotError(f"{path}: no joint {unknown!r}; joints are {names_text(joints)}")
    chain = _chain(model, path, tip, lock)
    data = mujoco.MjData(model)
    inside = {int(model.body_jntadr[b]) for b in chain}
    if model.nkey:
        for k in range(model.njnt):
            if k not in inside:
                place = slice(model.jnt_qposadr[k], _end(model, k))
                data.qpos[place] = model.key_qpos[0][place]
    data.qpos[[model.jnt_qposadr[k] for k in inside]] = 0.0  # not qpos0, which is a joint's `ref`
    mujoco.mj_forward(model, data)
    name = model.names[: model.names.find(b"\0")].decode(errors="replace")
    carried = [
        (model.body(b).name, tuple(_parameters(model, data, b, others[1:]).tolist()))
        for b in chain
        for others in [_rigid_with(model, b, chain)]
    ]
    return RobotDescription(
        name=name or "robot",
        joints=tuple(_joint(model, data, b, _rigid_with(model, b, chain)) for b in chain),
        gravity=_gravity(model),
        source=RobotSource(
            "mjcf", files[0][1], tip, tuple(lock), files=tuple(files), carried=tuple(carried)
        ),
        warnings=(*missing, *_locked(model, path, chain), *_not_read(model, path, chain)),
    )


def _require_bounded(path: Path) -> list[tuple[str, str]]:
    """Return names and texts of a model and its includes; refuse very many copies or cells."""
    waiting: list[tuple[Path, tuple[Path, ...]]] = [(path, ())]
    texts: dict[Path, str] = {}
    seen = 0
    while waiting:
        file, above = waiting.pop()
        seen += 1
        if file in above or seen > MOST_FILES:
            what = "attaches itself" if file in above else f"reads more than {MOST_FILES} files"
            raise RobotError(f"{path}: the model {what}; expected a MuJoCo model")
        texts[file] = text = read_text(file)
        if "<!ENTITY" in text:
            raise RobotError(f"{file}: not a MuJoCo model: found an entity definition")
        try:
            root = ElementTree.fromstring(text)
        except (ElementTree.ParseError, ValueError) as error:
            raise RobotError(f"{file}: not a MuJoCo model ({reason_of(error)})") from None
        for tag, count, most in _sizes(root, 1):
            if not count <= most:
                raise RobotError(
                    f"{file}: <{tag}> asks for {count:.3g} elements; expected at most {most:.0g}"
                )
        below = (*root.iter("include"), *root.iterfind("asset/model"))
        files = [path.parent / name for element in below if (name := element.get("file"))]
        waiting += [(below, (*above, file)) for below in files if below.is_file()]
    return [(os.path.relpath(file, path.parent), text) for file, text in texts.items()]


def _sizes(element: ElementTree.Element, copies: float) -> Iterator[tuple[str, float, float]]:
    """Yield tag, number and limit of the copies and cells that an element and those in it make."""
    tag = element.tag
    if tag in ("replicate", "composite", "flexcomp"):
        copies *= math.prod(_whole(x) for x in element.get("count", "1").split())
        yield tag, copies, MOST_COPIES
    elif tag in ("hfield", "texture"):
        names = ("nrow", "ncol") if tag == "hfield" else ("width", "height")
        yield tag, math.prod(_whole(element.get(x, "1")) for x in names), MOST_CELLS
    for below in element:
        yield from _sizes(below, copies)


def _whole(text: str) -> float:
    try:
        return max(float(text), 1.0)
    except ValueError:
        return 1.0  # MuJoCo names the place


def _without_appearance(spec: Any, path: Path) -> list[LieidWarning]:
    """Remove what dynamics do not need, and meshes whose file does not exist."""

    def remove(elements: Collection[Any]) -> None:
        for element in list(elements):
            spec.delete(element) if hasattr(spec, "delete") else element.delete()

    folder = path.parent / (spec.meshdir or "")
    missing = [
        mesh
        for mesh in spec.meshes
        if mesh.file and not any((at / mesh.file).is_file() for at in (folder, path.parent))
    ]
    names = {mesh.name or Path(mesh.file).stem for mesh in missing}
    files = sorted({mesh.file for mesh in missing})
    heights = {field.name for field in spec.hfields}
    for geom in spec.geoms:
        geom.material = ""
    remove([g for g in spec.geoms if g.meshname in names or g.hfieldname in heights])
    for group in (missing, spec.hfields, spec.skins, spec.pairs, spec.sensors):
        remove(group)
    for site in spec.sites:
        site.material = ""
    for tendon in spec.tendons:
        tendon.material = ""
    remove(spec.materials)
    remove(spec.textures)
    if not missing:
        return []
    return [
        MissingMeshWarning(
            f"{path}: no such mesh: {names_text(files)}; its shapes were left out, which changes "
            "the inertia of bodies that do not state theirs"
        )
    ]


def _end(model: Any, joint: int) -> int:
    """Return the end of a joint's coordinates."""
    following = joint + 1
    return int(model.jnt_qposadr[following]) if following < model.njnt else int(model.nq)


def _chain(model: Any, path: str | Path, tip: str | None, lock: Sequence[str]) -> list[int]:
    """Return the bodies with joints that are not locked from the base to the tip."""
    moving = [b for b in range(1, model.nbody) if _own_joints(model, b, lock)]
    if not moving:
        raise RobotError(f"{path}: found no joints, expected hinges or slides")

    def moving_parent(body: int) -> int:
        """Return the next moving body towards the base, 0 for none."""
        parent = int(model.body_parentid[body])
        while parent and parent not in moving:
            parent = int(model.body_parentid[parent])
        return parent

    if tip is not None:
        names = [model.body(b).name for b in range(model.nbody)]
        if tip not in names:
            raise RobotError(f"{path}: no body {tip!r}; expected one of {', '.join(names[1:])}")
        end = names.index(tip)
    else:
        parents = {moving_parent(b) for b in moving}
        ends = [b for b in moving if b not in parents]
        if len(ends) > 1:
            found = ", ".join(model.body(b).name for b in ends)
            raise RobotError(
                f"{path}: the model branches into chains that end at {found}; expected tip= "
                "(--tip BODY) or lock= (--lock JOINT…)"
            )
        end = ends[0]
    chain = [end] if end in moving else []
    while (end := moving_parent(end)) > 0:
        chain.append(end)
    if not 1 <= len(chain) <= MOST_JOINTS:
        raise RobotError(f"{path}: a chain of {len(chain)} joints; expected 1 to {MOST_JOINTS}")
    for body in chain:
        first, *others = _own_joints(model, body, lock)
        kinds = [int(model.jnt_type[k]) for k in (first, *others) if not _is_play(model, first, k)]
        if kinds not in ([SLIDE], [HINGE]):
            raise RobotError(
                f"{path}: body {model.body(body).name!r} has {len(kinds)} joints or one that is "
                "neither a hinge nor a slide; expected one hinge or slide per body"
            )
    return chain[::-1]


def _own_joints(model: Any, body: int, lock: Sequence[str] = ()) -> list[int]:
    first = int(model.body_jntadr[body])
    own = range(first, first + int(model.body_jntnum[body]))
    return [k for k in own if model.joint(k).name not in lock]


def _is_play(model: Any, first: int, joint: int) -> bool:
    """Return whether a joint has the axis of its body's first one and no actuator."""
    places = (model.jnt_axis, model.jnt_pos, model.jnt_type)
    same = all(np.allclose(place[first], place[joint]) for place in places)
    moved = model.actuator_trnid[model.actuator_trntype == 0, 0]
    return joint != first and same and joint not in moved


def _rigid_with(model: Any, body: int, chain: Sequence[int]) -> list[int]:
    """Return a body and those that move with it, with all joints off the chain locked."""
    found = [body]
    for other in range(body + 1, model.nbody):
        if model.body_parentid[other] in found and other not in chain:
            found.append(other)
    return found


def _locked(model: Any, path: str | Path, chain: Sequence[int]) -> Iterator[LieidWarning]:
    """Yield a warning for each link of the chain that carries locked branches."""
    for body in chain:
        branches = [b for b in _rigid_with(model, body, chain)[1:] if model.body_jntnum[b]]
        if not branches:
            continue
        joints = [model.joint(k).name for b in branches for k in _own_joints(model, b)]
        mass = sum(float(model.body_mass[b]) for b in branches)
        at = "the first keyframe" if model.nkey else "their pose qpos0"
        yield LockedBranchWarning(
            f"{path}: joints {names_text(joints)} are locked at {at}; their bodies, {mass:.3g} "
            f"kg, are part of {model.body(body).name!r}"
        )


def _not_read(model: Any, path: str | Path, chain: Sequence[int]) -> list[LieidWarning]:
    """Return a warning that names what acts on the chain and is not part of a description."""
    found: list[str] = []
    for number, body in enumerate(chain, start=1):
        index = int(model.body_jntadr[body])
        if model.jnt_stiffness[index] > 0.0:
            rest = float(model.qpos_spring[model.jnt_qposadr[index]])
            found.append(
                f"the spring of joint {model.joint(index).name} (stiffness "
                f"{model.jnt_stiffness[index]:.4g}, springref {rest:.4g}; the effects "
                f"position_spring:{number} and offset:{number} describe it)"
            )
    links = {other: body for body in chain for other in _rigid_with(model, body, chain)}
    found += [
        f"gravcomp = {model.body_gravcomp[body]:.4g} of body {model.body(body).name}"
        for body in sorted(links)
        if model.body_gravcomp[body] != 0.0
    ]
    if model.opt.density > 0.0 or model.opt.viscosity > 0.0:
        found.append("the fluid (density, viscosity)")
    found += _constraints_and_tendons(model, chain, links)
    found += _other_actuators(model, chain, links)
    return [NotReadWarning(f"{path}: not read: {'; '.join(found)}")] if found else []


def _constraints_and_tendons(
    model: Any, chain: Sequence[int], links: Mapping[int, int]
) -> Iterator[str]:
    """Yield the equality constraints and tendons that act on the chain, by name.

    ``links``: the body of the chain that each body moves with; others move with the base.
    """
    from mujoco import mjtEq, mjtObj

    for k in range(model.neq):
        ends, kind = (int(model.eq_obj1id[k]), int(model.eq_obj2id[k])), int(model.eq_type[k])
        if kind == mjtEq.mjEQ_JOINT:
            acts = any(end in _joints_of(model, chain) for end in ends)
        elif kind == mjtEq.mjEQ_TENDON:
            acts = any(end >= 0 and _tendon_acts(model, end, chain, links) for end in ends)
        elif kind in (mjtEq.mjEQ_CONNECT, mjtEq.mjEQ_WELD):
            sites = int(model.eq_objtype[k]) == mjtObj.mjOBJ_SITE
            bodies = [int(model.site_bodyid[end]) if sites else end for end in ends]
            acts = len({links.get(body, 0) for body in bodies}) > 1
        else:
            continue
        if acts:
            yield f"equality constraint {model.equality(k).name or k + 1}"
    for k in range(model.ntendon):
        force = (model.tendon_stiffness, model.tendon_damping, model.tendon_frictionloss)
        if any(np.any(values[k]) for values in force) and _tendon_acts(model, k, chain, links):
            yield f"tendon {model.tendon(k).name or k + 1} (stiffness, damping, frictionloss)"


def _other_actuators(model: Any, chain: Sequence[int], links: Mapping[int, int]) -> Iterator[str]:
    """Yield the dynamics of the chain's actuators, and actuators besides one for each joint."""
    from mujoco import mjtTrn

    for k in range(model.nu):
        index, kind = int(model.actuator_trnid[k, 0]), int(model.actuator_dyntype[k])
        name, transmission = model.actuator(k).name or f"{k + 1}", int(model.actuator_trntype[k])
        if transmission == mjtTrn.mjTRN_JOINT:
            if index not in _joints_of(model, chain):
                continue
            if k != _actuator_of(model, index):
                yield f"actuator {name}, a further one of joint {model.joint(index).name}"
            elif kind != NO_DYNAMICS:
                what = "its integrator" if kind == INTEGRATOR else "its time constant"
                value = model.actuator_dynprm[k, 0]
                yield f"the dynamics of actuator {name} ({what}, dynprm = {value:.4g})"
            continue
        if transmission == mjtTrn.mjTRN_JOINTINPARENT:
            acts = index in _joints_of(model, chain)
        elif transmission == mjtTrn.mjTRN_TENDON:
            acts = _tendon_acts(model, index, chain, links)
        else:  # at a site or a body
            at_body = transmission == mjtTrn.mjTRN_BODY
            acts = (index if at_body else int(model.site_bodyid[index])) in links
        if acts:
            yield f"actuator {name} (its transmission)"


def _joints_of(model: Any, chain: Sequence[int]) -> list[int]:
    return [int(model.body_jntadr[body]) for body in chain]


def _tendon_acts(model: Any, tendon: int, chain: Sequence[int], links: Mapping[int, int]) -> bool:
    """Return whether a tendon's length depends on the joints of the chain."""
    from mujoco import mjtWrap

    first, bodies = int(model.tendon_adr[tendon]), set()
    for k in range(first, first + int(model.tendon_num[tendon])):
        kind, own = int(model.wrap_type[k]), int(model.wrap_objid[k])
        if kind == mjtWrap.mjWRAP_JOINT and own in _joints_of(model, chain):
            return True
        if kind in (mjtWrap.mjWRAP_SPHERE, mjtWrap.mjWRAP_CYLINDER):
            bodies.add(links.get(int(model.geom_bodyid[own]), 0))
        elif kind == mjtWrap.mjWRAP_SITE:
            bodies.add(links.get(int(model.site_bodyid[own]), 0))
    return len(bodies) > 1


def _joint(model: Any, data: Any, body: int, bodies: list[int]) -> Joint:
    """Return the joint of a body, which moves ``bodies``."""
    index = int(model.body_jntadr[body])
    home = _pose(data, body)
    axis, anchor = np.array(data.xaxis[index]), np.array(data.xanchor[index])
    hinge = int(model.jnt_type[index]) == 3
    screw = np.concatenate([axis, -np.cross(axis, anchor)] if hinge else [np.zeros(3), axis])
    total = _parameters(model, data, body, bodies)
    low, high = model.jnt_range[index] if model.jnt_limited[index] else (NOT_STATED, NOT_STATED)
    drive, torque = _drive(model, index)
    return Joint(
        name=model.joint(index).name or f"joint{index + 1}",
        screw=screw,
        home=home,
        limits=Limits(float(low), float(high), torque=torque),
        link=total if total[0] > 0.0 else None,
        link_name=model.body(body).name,
        drive=drive,
    )


def _parameters(model: Any, data: Any, body: int, bodies: Sequence[int]) -> Array:
    """Return the link parameters (10,) of bodies together, in the frame of a body."""
    total, home = np.zeros(10), _pose(data, body)
    for other in bodies:
        between = np.asarray(np.linalg.solve(home, _pose(data, other)))
        turn = _rotation(model.body_iquat[other])
        inertia = turn @ np.diag(model.body_inertia[other]) @ turn.T
        own = link_parameters(float(model.body_mass[other]), model.body_ipos[other], inertia)
        total += parameter_transport(between) @ own
    return total


def _actuator_of(model: Any, joint: int) -> int | None:
    """Return the actuator of a joint: its first position servo, or else its first one."""
    at_joint = (model.actuator_trntype == 0) & (model.actuator_trnid[:, 0] == joint)
    own: list[int] = np.flatnonzero(at_joint).tolist()
    return next((k for k in own if _is_servo(model, k)), own[0] if own else None)


def _is_servo(model: Any, actuator: int) -> bool:
    """Return whether an actuator's force is kp·(ctrl − position) − kv·velocity."""
    gain, bias = float(model.actuator_gainprm[actuator, 0]), model.actuator_biasprm[actuator]
    alike = bias[1] < 0.0 and bool(np.isclose(gain, -bias[1]))
    return alike and int(model.actuator_dyntype[actuator]) != INTEGRATOR


def _drive(model: Any, joint: int) -> tuple[Drive | None, float]:
    """Return a joint's control law and torque limit, N·m; its stiffness has the gear squared."""
    force, k = NOT_STATED, _actuator_of(model, joint)
    if model.jnt_actfrclimited[joint]:
        force = float(model.jnt_actfrcrange[joint, 1])
    if k is None:
        return None, force
    gear, gain = abs(float(model.actuator_gear[k, 0])), float(model.actuator_gainprm[k, 0])
    if model.actuator_forcelimited[k]:
        force = float(np.fmin(force, gear * model.actuator_forcerange[k, 1]))
    if _is_servo(model, k):
        damping = max(-float(model.actuator_biasprm[k, 2]), 0.0)
        return Drive(stiffness=gear**2 * gain, damping=gear**2 * damping), force
    motor = not model.actuator_biastype[k] and not model.actuator_gaintype[k]
    if math.isnan(force) and model.actuator_ctrllimited[k] and motor:
        force = float(model.actuator_ctrlrange[k, 1]) * gain * gear
    return None, force


def _gravity(model: Any) -> Array:
    from mujoco import mjtDisableBit

    on = not model.opt.disableflags & int(mjtDisableBit.mjDSBL_GRAVITY)
    return np.array(model.opt.gravity, dtype=float) * on


def _pose(data: Any, body: int) -> Array:
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = data.xmat[body].reshape(3, 3), data.xpos[body]
    return pose


def _rotation(quaternion: Array) -> Array:
    from scipy.spatial.transform import Rotation

    w, x, y, z = quaternion
    return np.asarray(Rotation.from_quat([x, y, z, w]).as_matrix())
