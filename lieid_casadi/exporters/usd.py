"""``lieid export FIT --to usd --into ARM.usd``: the user's own stage with identified masses.

Mass properties of the moving links and the armature of the joints are written into the root layer;
all else stays as it is. A link is what the joint of the robot's name moves (``physics:body1``).
"""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import Any

import numpy as np

from lieid_casadi.arrays import Array
from lieid_casadi.errors import ExportError
from lieid_casadi.exporters.simulator_joints import armature, check_possible, left_out
from lieid_casadi.exporters.urdf import check_gravity, split
from lieid_casadi.identification.fit import Fit
from lieid_casadi.robot.inertia import body_inertia
from lieid_casadi.robot.urdf import RigidMember, rigid_members

AT_ORIGIN = 1e-6  # m: a joint's frame is the link's own


def usd_files(fit: Fit, into: str | Path | None) -> tuple[dict[str, bytes], list[str]]:
    """Return the stage with the numbers of a fit by its name, and notes.

    Raises `ExportError`: no stage is given or it cannot be read, ``usd-core`` is not installed, a
    joint of the robot is not in the stage, or the fit is refused as for ``urdf``.
    """
    if into is None:
        raise ExportError("usd writes into your own stage; expected --into FILE (into=)")
    try:
        from pxr import Sdf, Tf, Usd
    except ImportError:
        raise ExportError("usd needs the extra usd: pip install 'lieid-casadi[usd]'") from None
    check_possible(fit)
    check_gravity(fit)
    path = Path(into)
    try:
        layer = Sdf.Layer.FindOrOpen(str(path))
        stage = None if layer is None else Usd.Stage.Open(layer)
    except Tf.ErrorException:
        stage = None
    if stage is None:
        raise ExportError(f"{path}: not a USD stage, or not readable")
    try:
        notes = _edit(stage, fit, str(path))
        with tempfile.TemporaryDirectory() as folder:
            copy = Path(folder) / path.name
            layer.Export(str(copy))
            content = copy.read_bytes()
    finally:
        layer.Reload(True)  # layers are shared by all of a process
    if layer.GetExternalReferences():
        notes.append("files that the stage refers to are named relative to its own folder")
    left = left_out(fit, friction=False)
    if left:
        notes.append(f"not exported, because USD has no attribute for it: {', '.join(left)}; ")
        notes[-1] += "--to isaaclab has friction"
    return {path.name: content}, notes


def _edit(stage: Any, fit: Fit, origin: str) -> list[str]:
    """Write the numbers of a fit into a stage, and return notes."""
    from pxr import UsdGeom, UsdPhysics

    meter = UsdGeom.GetStageMetersPerUnit(stage)
    kilogram = UsdPhysics.GetStageKilogramsPerUnit(stage)
    joints = {p.GetName(): p for p in stage.Traverse() if p.IsA(UsdPhysics.Joint)}
    bodies = {
        p.GetName(): p
        for p in stage.Traverse()
        if p.HasAPI(UsdPhysics.RigidBodyAPI) or p.HasAPI(UsdPhysics.MassAPI)
    }
    notes, source = list[str](), fit.model.robot.source
    rigid: list[list[RigidMember]] = [[] for _ in fit.model.robot.joints]
    if source is not None and source.kind == "urdf":
        rigid = rigid_members(source.text, fit.model.robot.joints)
    for j, joint in enumerate(fit.model.robot.joints):
        if joint.name not in joints:
            found = ", ".join(sorted(joints)) or "none"
            raise ExportError(f"{origin}: no joint {joint.name!r}; its joints: {found}")
        prim = joints[joint.name]
        link = _link_of(stage, UsdPhysics.Joint(prim), f"{origin}: {joint.name}")
        # importers may have merged links that are attached rigidly: these have no prim
        attached = [member for member in rigid[j] if member.name in bodies]
        shared = split(fit.link_parameters.reshape(-1, 10)[j], attached)
        for member in shared.members:
            _write_mass(bodies[member.name], shared.share * member.nominal, meter, kilogram)
            notes.append(
                f"{member.name}: {100.0 * shared.share:.3g} % of its stated inertia; "
                f"{link.GetName()} has the rest"
            )
        _write_mass(link, shared.own, meter, kilogram)
        _write_armature(prim, armature(fit, j), joint.revolute, meter, kilogram)
    return notes


def _link_of(stage: Any, joint: Any, origin: str) -> Any:
    """Return the prim that a joint moves, whose frame is that of the joint."""
    targets = joint.GetBody1Rel().GetTargets()
    link = stage.GetPrimAtPath(targets[0]) if targets else None
    if not link:
        raise ExportError(f"{origin}: physics:body1 names no prim; expected the link it moves")
    place = np.array(joint.GetLocalPos1Attr().Get() or (0.0, 0.0, 0.0), dtype=float)
    if np.linalg.norm(place) > AT_ORIGIN or link.IsInstanceProxy():
        raise ExportError(
            f"{origin}: the frame of {link.GetName()} is not that of its joint, or it is an "
            "instance; expected a stage whose links have the frames of the URDF, not instanced"
        )
    return link


def _write_mass(link: Any, parameters: Array, meter: float, kilogram: float) -> None:
    """Write link parameters (10,) as mass, centre of mass and principal inertia."""
    from pxr import Gf, UsdPhysics
    from scipy.spatial.transform import Rotation

    body = body_inertia(parameters)
    moments, axes = np.linalg.eigh(body.inertia)
    axes[:, 2] *= np.linalg.det(axes)  # right-handed
    x, y, z, w = Rotation.from_matrix(axes).as_quat()
    mass = UsdPhysics.MassAPI.Apply(link)
    mass.CreateMassAttr().Set(float(body.mass / kilogram))
    mass.CreateCenterOfMassAttr().Set(Gf.Vec3f(*map(float, body.com / meter)))
    mass.CreateDiagonalInertiaAttr().Set(Gf.Vec3f(*map(float, moments / (kilogram * meter**2))))
    mass.CreatePrincipalAxesAttr().Set(Gf.Quatf(float(w), float(x), float(y), float(z)))


def _write_armature(
    prim: Any, inertia: float | None, revolute: bool, meter: float, kilogram: float
) -> None:
    """Write the armature of a joint as PhysX reads it, if the model has one."""
    from pxr import Sdf

    if inertia is not None:
        unit = kilogram * (meter**2 if revolute else 1.0)
        attribute = prim.CreateAttribute("physxJoint:armature", Sdf.ValueTypeNames.Float)
        attribute.Set(float(inertia / unit))
