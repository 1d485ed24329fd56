"""Files of a two-link arm for the tests of commands, and the shape of a refusal."""

from pathlib import Path

import numpy as np

import lieid_casadi as lieid

URDF = """<robot name="arm">
  <link name="base"/><link name="upper">{inertial}</link><link name="fore">{inertial}</link>
  <joint name="shoulder" type="{kind}"><parent link="base"/><child link="upper"/>
    <axis xyz="0 1 0"/><limit lower="-3" upper="3" effort="50" velocity="3"/></joint>
  <joint name="elbow" type="revolute"><parent link="upper"/><child link="fore"/>
    <origin xyz="0.5 0 0"/><axis xyz="0 1 0"/>
    <limit lower="-3" upper="3" effort="50" velocity="3"/></joint>{more}
</robot>"""


INERTIAL = (
    '<inertial><origin xyz="0.2 0 0"/><mass value="3"/>'
    '<inertia ixx="0.01" ixy="0" ixz="0" iyy="0.02" iyz="0" izz="0.02"/></inertial>'
)


def urdf(*, kind="revolute", inertial=INERTIAL, more=""):
    return URDF.format(kind=kind, inertial=inertial, more=more)


def columns(n=2, seconds=8.0, rate=100.0):
    """A motion of the two-link arm with the torques of Pinocchio's plant, as named columns."""
    from lieid_casadi.plant import Arm, JointFriction, measure_along

    robot = lieid.robots.two_link()
    t = np.arange(0, seconds, 1 / rate)
    phase = 2 * np.pi * np.outer(t, [0.31, 0.47])
    w = 2 * np.pi * np.array([0.31, 0.47])
    q, dq, ddq = np.sin(phase), w * np.cos(phase), -(w**2) * np.sin(phase)
    friction = JointFriction(np.array([1.0, 0.5]), np.array([0.3, 0.2]), np.zeros(2))
    recording = measure_along(Arm(robot, robot.link_parameters, friction), t, q, dq, ddq)
    table = {"t": recording.t}
    for name, values in (("q", recording.q), ("dq", recording.dq), ("tau", recording.tau)):
        for j in range(n):
            table[f"{name}{j + 1}"] = values[:, j]
    return table


def write(path, table):
    data = np.column_stack(list(table.values()))
    np.savetxt(path, data, delimiter=",", header=",".join(table), comments="", fmt="%.10g")
    return str(path)


def refused(outcome, *words):
    """The outcome is status 2 with one line on stderr that has these words."""
    status, _, err = outcome
    assert status == 2, err
    assert err.count("\n") == 1
    assert err.endswith("\n")
    for word in words:
        assert word in err


def tree(folder):
    return {
        path.relative_to(folder).as_posix(): path.read_bytes()
        for path in sorted(Path(folder).rglob("*"))
        if path.is_file()
    }
