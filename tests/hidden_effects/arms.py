"""Three arms in which effects are hidden, as YAML, URDF and YAML files.

``panda`` is the bundled one. ``ur10e`` is made from the Denavit-Hartenberg parameters, masses and
centres of mass that Universal Robots publishes (support article "DH parameters for calculations of
kinematics and dynamics"); inertias are those of cylinders of such size. ``rail`` is an arm of a
TX40's size, without the last joint, on a horizontal rail: its first joint slides.
"""

from __future__ import annotations

import math

import numpy as np

from lieid_casadi.robot import Robot
from lieid_casadi.robot.yaml_file import write_yaml

ARMS = ("panda", "ur10e", "rail")

# a, d, alpha, mass, centre of mass in the DH frame, radius of a cylinder, torque limit, speed limit
_UR10E = (
    (0.0, 0.1807, math.pi / 2, 7.369, (0.021, 0.0, 0.027), 0.09, 330.0, 2.0944),
    (-0.6127, 0.0, 0.0, 13.051, (0.38, 0.0, 0.158), 0.07, 330.0, 2.0944),
    (-0.57155, 0.0, 0.0, 3.989, (0.24, 0.0, 0.068), 0.06, 150.0, 3.1416),
    (0.0, 0.17415, math.pi / 2, 2.1, (0.0, 0.007, 0.018), 0.05, 56.0, 3.1416),
    (0.0, 0.11985, -math.pi / 2, 1.98, (0.0, 0.007, 0.018), 0.05, 56.0, 3.1416),
    (0.0, 0.11655, 0.0, 0.615, (0.0, 0.0, -0.026), 0.045, 56.0, 3.1416),
)

_RAIL = """
name: rail
joints:
  - name: rail
    screw: [0, 0, 0, 0, 1, 0]
    home: {xyz: [0, 0, 0.1]}
    limits: {position: [-0.8, 0.8], velocity: 1.0, acceleration: 4.0, torque: 800.0}
    link: {mass: 22.0, com: [0.01, 0.03, 0.05], inertia: {ixx: 0.5, iyy: 0.4, izz: 0.6}}
  - name: yaw
    screw: [0, 0, 1, 0, 0, 0]
    home: {xyz: [0, 0, 0.32]}
    limits: {position: [-2.9, 2.9], velocity: 3.5, acceleration: 12.0, torque: 70.0}
    link: {mass: 7.0, com: [0.02, 0.03, -0.05], inertia: {ixx: 0.06, iyy: 0.05, izz: 0.04}}
  - name: shoulder
    screw: [0, 1, 0, -0.32, 0, 0]
    home: {xyz: [0, 0.035, 0.32]}
    limits: {position: [-2.0, 2.0], velocity: 3.0, acceleration: 12.0, torque: 60.0}
    link: {mass: 5.5, com: [0.01, 0.04, 0.12], inertia: {ixx: 0.06, iyy: 0.06, izz: 0.02}}
  - name: elbow
    screw: [0, 1, 0, -0.545, 0, 0]
    home: {xyz: [0, 0.035, 0.545]}
    limits: {position: [-2.2, 2.2], velocity: 4.0, acceleration: 14.0, torque: 35.0}
    link: {mass: 3.6, com: [0.01, -0.02, 0.05], inertia: {ixx: 0.02, iyy: 0.02, izz: 0.01, ixz: 0.001}}
  - name: roll
    screw: [0, 0, 1, 0.035, 0, 0]
    home: {xyz: [0, 0.035, 0.66]}
    limits: {position: [-3.0, 3.0], velocity: 5.0, acceleration: 20.0, torque: 14.0}
    link: {mass: 1.4, com: [0.005, 0.01, 0.04], inertia: {ixx: 0.006, iyy: 0.006, izz: 0.002}}
  - name: wrist
    screw: [0, 1, 0, -0.77, 0, 0]
    home: {xyz: [0, 0.035, 0.77]}
    limits: {position: [-2.1, 2.1], velocity: 5.0, acceleration: 20.0, torque: 10.0}
    link: {mass: 0.7, com: [0.02, 0.005, 0.06], inertia: {ixx: 0.003, iyy: 0.003, izz: 0.001}}
tool: {xyz: [0, 0, 0.12]}
"""  # noqa: E501


def robot_text(name: str) -> tuple[str, str]:
    """Return the file name and text that describe an arm."""
    if name == "panda":
        return "robot.yaml", write_yaml(Robot.load("panda"))
    if name == "ur10e":
        return "robot.urdf", _urdf()
    return "robot.yaml", _RAIL


def load_arm(name: str) -> Robot:
    """Return the arm of a name."""
    file, text = robot_text(name)
    if file.endswith(".yaml"):
        return Robot.parse_yaml(text)
    return Robot.parse_urdf(text)


def _urdf() -> str:
    links = ['<link name="base"/>']
    joints = []
    parent, origin = "base", (0.0, 0.0, 0.0, 0.0)
    for i, (a, d, alpha, mass, com, radius, torque, speed) in enumerate(_UR10E, start=1):
        x, y, z, turned = origin
        joints.append(
            f'<joint name="joint_{i}" type="revolute"><parent link="{parent}"/>'
            f'<child link="link_{i}"/><origin xyz="{x} {y} {z}" rpy="{turned!r} 0 0"/>'
            f'<axis xyz="0 0 1"/><limit lower="-3.1" upper="3.1" effort="{torque}" '
            f'velocity="{speed}"/></joint>'
        )
        c, s = math.cos(alpha), math.sin(alpha)
        centre = np.array([a, 0.0, d]) + np.array([[1, 0, 0], [0, c, -s], [0, s, c]]) @ com
        length = max(abs(a), abs(d), 2.0 * radius)
        along, across = 0.5 * mass * radius**2, mass * (3.0 * radius**2 + length**2) / 12.0
        inertia = (along, across, across) if abs(a) > abs(d) else (across, across, along)
        links.append(
            f'<link name="link_{i}"><inertial>'
            f'<origin xyz="{" ".join(map(repr, centre.tolist()))}"/>'
            f'<mass value="{mass}"/><inertia ixx="{inertia[0]!r}" iyy="{inertia[1]!r}" '
            f'izz="{inertia[2]!r}" ixy="0" ixz="0" iyz="0"/></inertial></link>'
        )
        parent, origin = f"link_{i}", (a, 0.0, d, alpha)
    return '<robot name="ur10e">\n' + "\n".join(links + joints) + "\n</robot>\n"
