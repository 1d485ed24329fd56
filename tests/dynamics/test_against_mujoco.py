"""The same quantities against MuJoCo, whose model is built from the screws by the tests."""

from dataclasses import replace

import mujoco
import numpy as np
import pytest
from robot.random_arms import mass_com_inertia, random_link, to_mujoco

TOLERANCE = 1e-10  # relative to the largest entry


class Simulated:
    """An arm in MuJoCo, one state at a time."""

    def __init__(self, arm):
        self.arm, self.model = arm, to_mujoco(arm.robot)
        self.data = mujoco.MjData(self.model)

    def torque(self, q, dq, ddq):
        self.data.qpos, self.data.qvel, self.data.qacc = q, dq, ddq
        mujoco.mj_inverse(self.model, self.data)
        return self.data.qfrc_inverse.copy()

    def over_states(self, function):
        return np.array([function(*state) for state in self.arm.moments])


@pytest.fixture(scope="session")
def arm(arm):
    """MuJoCo refuses bodies without extent (TX40's link 6): such an arm gets other links."""
    if all(np.linalg.eigvalsh(mass_com_inertia(j.link)[2]).min() > 1e-9 for j in arm.robot.joints):
        return arm
    rng = np.random.default_rng(0)
    joints = tuple(replace(joint, link=random_link(rng)) for joint in arm.robot.joints)
    return replace(arm, robot=replace(arm.robot, joints=joints))


@pytest.fixture(scope="session")
def simulated(arm):
    return Simulated(arm)


def assert_close(ours, theirs):
    scale = np.abs(theirs).max()
    np.testing.assert_allclose(ours, theirs, rtol=0, atol=TOLERANCE * scale)


def test_torque(arm, simulated):
    theirs = simulated.over_states(simulated.torque)
    assert_close(arm.compiled.inverse_dynamics(*arm.states, arm.robot.link_parameters), theirs)
    assert_close(arm.compiled.regressor(*arm.states) @ arm.robot.link_parameters, theirs)
