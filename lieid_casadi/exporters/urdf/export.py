"""``lieid export FIT --to urdf``: the robot with the identified inertias."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from lieid_casadi.errors import ExportError
from lieid_casadi.exporters.joint_friction import left_out, negative, simulator_joints
from lieid_casadi.exporters.urdf.control import isaac_joints, with_ros2_control
from lieid_casadi.exporters.urdf.edit import edited_urdf
from lieid_casadi.exporters.urdf.mujoco_joints import mjcf_snippet
from lieid_casadi.exporters.urdf.write import written_urdf
from lieid_casadi.identification.fit import Fit
from lieid_casadi.output_folder import check_folder, write_folder
from lieid_casadi.robot.description import STANDARD_GRAVITY


@dataclass(frozen=True)
class UrdfExport:
    """The files of an export, and notes for their users."""

    urdf: Path
    mjcf: Path
    isaac: Path
    notes: tuple[str, ...]


def export_urdf(fit: Fit, folder: str | Path, *, force: bool = False) -> UrdfExport:
    """Write ``ROBOT.urdf``, ``ROBOT_joints.xml`` (MuJoCo) and ``ROBOT_joints.yaml`` (Isaac Lab).

    The URDF is the one that the robot was read from, with the identified inertias and, where
    the model has them, viscous and Coulomb friction; everything else stays as it was. A robot
    from YAML gets a URDF written from its screws.

    ``fit``: of method ``feasible``; ``folder``: made if it does not exist; written as a whole or
    not at all; ``force``: replace what an earlier export wrote into the folder; other files are
    kept.
    Raises `ExportError`: the fit's masses and inertias are not certified to be physically
    consistent; the message has the command that makes a fit whose are. Raises `OutputError`: the
    folder has other content or cannot be written.
    """
    check_folder(folder, force=force)
    text, notes = urdf_text(fit)
    name = file_name(fit.model.robot.name)
    snippet = mjcf_snippet(fit, file=f"{name}_joints.xml")
    isaac = isaac_joints(fit.model.robot, simulator_joints(fit))
    files = {
        f"{name}.urdf": with_ros2_control(text, fit.model.robot).encode(),
        f"{name}_joints.xml": snippet.encode(),
        f"{name}_joints.yaml": isaac.encode(),
    }
    urdf, mjcf, yaml_file = write_folder(folder, files, force=force)
    return UrdfExport(urdf, mjcf, yaml_file, tuple(notes))


def urdf_text(fit: Fit) -> tuple[str, list[str]]:
    """Return the URDF and notes on it; raises as `export_urdf`."""
    check_possible(fit)
    robot = fit.model.robot
    if robot.source is not None and robot.source.kind == "urdf":
        text, notes = edited_urdf(fit, robot.source.text)
    else:
        bodies = fit.link_parameters.reshape(-1, 10)
        text, notes = written_urdf(robot, bodies, simulator_joints(fit))
    left = left_out(fit, {"armature", "damping", "friction"})
    if any(numbers.armature is not None for numbers in simulator_joints(fit)):
        notes.append("URDF has no element for armature; it is in the MuJoCo file")
    if left:
        notes.append(
            f"not exported, because URDF and MuJoCo have no element for it: {', '.join(left)}"
        )
    if negative(fit):
        notes.append(f"written as 0 because it is negative: {', '.join(negative(fit))}")
    if not np.allclose(robot.gravity, STANDARD_GRAVITY, atol=1e-9):
        x, y, z = robot.gravity
        notes.append(f"URDF has no element for gravity; set it to ({x:g}, {y:g}, {z:g}) m/s²")
    return text, notes


def check_possible(fit: Fit) -> None:
    """Refuse a fit whose masses and inertias are not certified to be physically consistent.

    Raises `ExportError`: with the command that makes a fit whose are.
    """
    if fit.certificate is not None and fit.certificate.holds and fit.physically_consistent:
        return
    effects = ",".join(fit.model.effects)
    runs = " ".join(source.name or "TRAIN" for source in fit.provenance.recordings) or "TRAIN…"
    option = f" --effects {effects}" if effects else ""
    raise ExportError(
        f"masses and inertias of a fit of method {fit.method} may not be physically consistent; "
        f"expected a fit of method feasible: lieid identify ROBOT {runs}{option} --method feasible "
        "-o fit.json"
    )


def file_name(name: str) -> str:
    """Return a name of a file for the name of a robot."""
    return "".join(c if c.isalnum() or c in "-_." else "_" for c in name) or "robot"
