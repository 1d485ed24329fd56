"""Arms and an inverse dynamics of MuJoCo for the tests of the plant."""

from dataclasses import replace

import numpy as np
from robot.random_arms import to_mujoco

from lieid_casadi.plant import Arm, JointFriction
from lieid_casadi.robot import Joint, Limits, Robot


def with_links(robot, parameters):
    """The robot with other link parameters (10 n,)."""
    links = np.asarray(parameters).reshape(-1, 10)
    joints = [replace(j, link=link) for j, link in zip(robot.joints, links, strict=True)]
    return replace(robot, joints=tuple(joints))


class MujocoArm:
    """The rigid arm in MuJoCo."""

    def __init__(self, robot):
        import mujoco

        self.mujoco = mujoco
        self.model = to_mujoco(robot)
        self.data = mujoco.MjData(self.model)

    def torques(self, q, dq, ddq):
        """Inverse dynamics (N, n)."""
        tau = np.empty_like(q)
        for k in range(len(q)):
            self.data.qpos, self.data.qvel, self.data.qacc = q[k], dq[k], ddq[k]
            self.mujoco.mj_inverse(self.model, self.data)
            tau[k] = self.data.qfrc_inverse
        return tau

    def tool(self, q):
        """Tool position, orientation, and Jacobian [ω; v] in base axes."""
        self.data.qpos = q
        self.mujoco.mj_forward(self.model, self.data)
        linear, angular = np.zeros((2, 3, q.size))
        self.mujoco.mj_jacSite(self.model, self.data, linear, angular, 0)
        pose = self.data.site_xpos[0].copy(), self.data.site_xmat[0].reshape(3, 3).copy()
        return *pose, np.vstack([angular, linear])


def arm_of(robot, *, coulomb=0.5, viscous=0.3, offset=0.1, effects=(), **others):
    """An arm with nominal inertias and the same friction on all joints."""
    n = robot.n
    friction = JointFriction(np.full(n, coulomb), np.full(n, viscous), np.full(n, offset))
    return Arm(robot, robot.link_parameters, friction, tuple(effects), **others)


def slider(mass=2.0):
    """One mass that slides along x, without gravity along it."""
    link = np.array([mass, 0, 0, 0, 0.1, 0, 0.1, 0, 0, 0.1])
    return Robot(
        name="slider",
        joints=(
            Joint(
                name="x",
                screw=np.array([0.0, 0, 0, 1, 0, 0]),
                home=np.eye(4),
                limits=Limits(-10.0, 10.0, 5.0, 20.0, 1000.0),
                link=link,
                link_name="mass",
            ),
        ),
    )
