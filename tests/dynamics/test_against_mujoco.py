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

    def mass_matrix(self, q, dq, ddq):
        self.torque(q, dq, ddq)
        rows, unit = np.zeros((self.model.nv, self.model.nv)), np.eye(self.model.nv)
        for row, direction in zip(rows, unit, strict=True):
            mujoco.mj_mulM(self.model, self.data, row, direction)
        return rows

    def jacobian(self, q, dq, ddq):
        self.torque(q, dq, ddq)
        linear, angular = np.zeros((2, 3, self.model.nv))
        mujoco.mj_jacSite(self.model, self.data, linear, angular, 0)
        return np.vstack([angular, linear])

    def over_states(self, function):
        return np.array([function(*state) for state in self.arm.moments])


@pytest.fixture(scope="session")
def arm(arm):
    """MuJoCo refuses bodies without extent (TX40's link 6): such an arm gets other links."""
    if all(np.linalg.eigvalsh(mass_com_inertia(j.link)[2]).min() > 1e-9 for j in arm.robot.joints):
        return arm
    rng = np.random.default_rng(0)
    return with_links(arm, [random_link(rng) for _ in arm.robot.joints])


def with_links(arm, links):
    joints = [replace(j, link=link) for j, link in zip(arm.robot.joints, links, strict=True)]
    return replace(arm, robot=replace(arm.robot, joints=tuple(joints)))


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


def test_regressor_itself(arm, simulated):
    """The torque's change with each parameter of the last link, in which it is linear.

    Each change adds mass and inertia too, so that MuJoCo gets a body that can exist.
    """
    state, links = arm.moments[0], [joint.link for joint in arm.robot.joints]
    ours = arm.compiled.regressor(*(values[:1] for values in arm.states))[0, :, -10:]
    before = simulated.torque(*state)
    scale = np.abs(ours).max()
    for parameter in range(10):
        change = np.array([1.0, 0, 0, 0, 1.0, 0, 1.0, 0, 0, 1.0])
        change[parameter] += 0.2
        other = Simulated(with_links(arm, [*links[:-1], links[-1] + change]))
        difference = other.torque(*state) - before
        # the difference of two torques loses digits: 1e-9
        np.testing.assert_allclose(ours @ change, difference, rtol=0, atol=1e-9 * scale)
