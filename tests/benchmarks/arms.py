"""Arms of the benchmarks: 6, 7 and 12 joints."""

import numpy as np

from lieid_casadi import robots
from lieid_casadi.robot import Joint, Robot

# a, alpha, d of a UR10e (Universal Robots' published DH parameters), m and rad
UR10E = (
    (0.0, np.pi / 2, 0.1807), (-0.6127, 0.0, 0.0), (-0.57155, 0.0, 0.0),
    (0.0, np.pi / 2, 0.17415), (0.0, -np.pi / 2, 0.11985), (0.0, 0.0, 0.11655),
)  # fmt: skip


def panda():
    return robots.panda()


def six_joints():
    """A UR10e's kinematics with made-up inertias."""
    return _from_dh("ur10e_like", UR10E)


def twelve_joints():
    """Two such arms, one on the other's flange."""
    return _from_dh("twelve", UR10E + UR10E)


def _from_dh(name, table):
    rng, home, joints = np.random.default_rng(0), np.eye(4), []
    for k, (a, alpha, d) in enumerate(table):
        axis, origin = home[:3, 2], home[:3, 3]
        screw = np.concatenate([axis, -np.cross(axis, origin)])
        joints.append(Joint(f"joint{k + 1}", screw, home.copy(), link=_link(rng)))
        home = home @ _step(a, alpha, d)
    return Robot(name, tuple(joints), tool=np.linalg.solve(joints[-1].home, home))


def _step(a, alpha, d):
    c, s = np.round(np.cos(alpha), 12), np.round(np.sin(alpha), 12)
    return np.array([[1.0, 0, 0, a], [0, c, -s, 0], [0, s, c, d], [0, 0, 0, 1]])


def _link(rng):
    """Ten link parameters of a cloud of point masses."""
    masses, points = rng.uniform(0.1, 1.0, 6), rng.uniform(-0.2, 0.2, (6, 3))
    i = sum(m * (p @ p * np.eye(3) - np.outer(p, p)) for m, p in zip(masses, points, strict=True))
    six = [i[0, 0], i[0, 1], i[1, 1], i[0, 2], i[1, 2], i[2, 2]]
    return np.array([masses.sum(), *(masses @ points), *six])
