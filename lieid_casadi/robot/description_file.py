"""Description of a robot from a file of any known format, or by a bundled name."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from lieid_casadi.errors import RobotError
from lieid_casadi.robot import bundled
from lieid_casadi.robot.joint import RobotDescription
from lieid_casadi.robot.mjcf import read_mjcf
from lieid_casadi.robot.text_file import read_text
from lieid_casadi.robot.urdf import read_urdf
from lieid_casadi.robot.yaml_file import read_yaml


def read_description(
    path: str | Path, *, tip: str | None = None, lock: Sequence[str] = ()
) -> RobotDescription:
    """Read a URDF, MJCF or YAML file, or a bundled description; see `Robot.load`.

    Parameters
    ----------
    path : str or Path
        File, or one of `bundled.NAMES`. ``.xml`` is MJCF if it has the element ``mujoco``.
    tip : str, optional
        Last link of a URDF's chain, or body at which an MJCF's chain ends.
    lock : sequence of str
        Joints of a URDF to lock at zero.

    Raises
    ------
    RobotError
        The file is missing, of another type, or not a serial arm; ``tip`` or ``lock`` with a
        format that has no choice of them.
    """
    origin, suffix = str(path), Path(path).suffix.lower()
    if origin in bundled.NAMES or suffix in (".yaml", ".yml"):
        if tip is not None or lock:
            raise RobotError(f"{path}: --tip and --lock apply to URDF files only")
        text = bundled.text(origin) if origin in bundled.NAMES else read_text(path)
        return read_yaml(text, origin=origin)
    if suffix == ".xml" and "<mujoco" in read_text(path):
        if lock:
            raise RobotError(f"{path}: --lock applies to URDF files only")
        return read_mjcf(path, tip=tip)
    if suffix in (".urdf", ".xml"):
        return read_urdf(read_text(path), tip=tip, lock=lock, origin=origin)
    names = ", ".join(bundled.NAMES)
    raise RobotError(
        f"{path}: expected a .urdf, .xml (URDF or MJCF) or .yaml file, or one of {names}"
    )
