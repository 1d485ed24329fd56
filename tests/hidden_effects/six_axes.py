"""A six-joint arm with a spherical wrist that no robot maker sells."""

import numpy as np

from lieid_casadi.robot import Joint, Limits, Robot
from lieid_casadi.robot.inertia import link_parameters

_AXES = ((0, 0, 1), (0, 1, 0), (0, 1, 0), (1, 0, 0), (0, 1, 0), (1, 0, 0))
_ORIGINS = (
    (0, 0, 0.3),
    (0.05, 0, 0.4),
    (0.05, 0, 0.95),
    (0.3, 0, 1.0),
    (0.7, 0, 1.0),
    (0.8, 0, 1.0),
)
_MASS = (12.0, 9.0, 6.0, 3.5, 2.0, 0.8)
_COM = (
    (0, 0.02, 0.05),
    (0.01, -0.05, 0.27),
    (0.1, 0.03, 0.02),
    (0.2, 0.01, 0),
    (0.04, 0, 0.02),
    (0.03, 0.01, 0),
)
_TORQUE, _SPEED = (200.0, 200.0, 120.0, 30.0, 30.0, 15.0), (2.0, 2.0, 2.5, 3.5, 3.5, 4.0)


def six_axes():
    joints = []
    for k, (axis, origin) in enumerate(zip(_AXES, _ORIGINS, strict=True)):
        home = np.eye(4)
        home[:3, 3] = origin
        omega = np.array(axis, dtype=float)
        screw = np.concatenate([omega, -np.cross(omega, origin)])
        size = 0.02 * _MASS[k] * np.array([0.25, 0.3, 0.2])
        link = link_parameters(_MASS[k], np.array(_COM[k], dtype=float), np.diag(size))
        limits = Limits(-2.6, 2.6, _SPEED[k], 6.0, _TORQUE[k])
        joints.append(Joint(f"axis{k + 1}", screw, home, limits, link, f"link{k + 1}"))
    return Robot("six_axes", tuple(joints))
