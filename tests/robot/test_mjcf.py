"""Robots from MuJoCo models."""

import mujoco
import numpy as np
import pytest
from exporters.c_arms import made_fit
from robot.random_arms import random_arm

import lieid_casadi as lieid
from lieid_casadi.errors import RobotError
from lieid_casadi.exporters.mjcf import mjcf_text
from lieid_casadi.robot.drive import Drive

ARM = """<mujoco model="bench"><compiler angle="radian"/><worldbody>
<body name="base" pos="0.1 0 0.3" euler="0 0 0.4"><inertial mass="3" pos="0 0 0"
   diaginertia="1 1 1"/>
 <body name="upper" pos="0 0 0.1" euler="0.3 0.2 0">
  <joint name="shoulder" axis="0 0.6 0.8" pos="0.05 0.02 0" range="-2 2"/>
  <geom type="capsule" fromto="0 0 0 0.4 0 0" size="0.03"/>
  <body name="cover" pos="0.2 0.05 0"><geom type="box" size="0.02 0.03 0.04"/></body>
  <body name="slide" pos="0.4 0 0"><joint name="lift" type="slide" axis="0 1 0"/>
   <geom type="sphere" size="0.05"/></body></body></body></worldbody>
<actuator><position name="a" joint="shoulder" kp="30" kv="2" forcerange="-12 12"/>
<motor name="b" joint="lift" ctrlrange="-7 7"/></actuator></mujoco>"""


def torque(path, q, dq, ddq):
    model = mujoco.MjModel.from_xml_path(str(path))
    data = mujoco.MjData(model)
    data.qpos[:], data.qvel[:], data.qacc[:] = q, dq, ddq
    mujoco.mj_inverse(model, data)
    return data.qfrc_inverse.copy()


def test_torque_is_that_of_mujoco(tmp_path):
    path = tmp_path / "arm.xml"
    path.write_text(ARM)
    robot = lieid.Robot.load(path)
    assert [joint.name for joint in robot.joints] == ["shoulder", "lift"]
    assert [joint.revolute for joint in robot.joints] == [True, False]
    random, arm = np.random.default_rng(0), lieid.compile(robot)
    for _ in range(20):
        motion = random.uniform(-1.5, 1.5, (3, 2))
        found = arm.inverse_dynamics(*motion[:, None], robot.link_parameters)[0]
        np.testing.assert_allclose(found, torque(path, *motion), rtol=1e-9, atol=1e-9)
    assert robot.joints[0].drive == Drive(stiffness=30.0, damping=2.0)
    np.testing.assert_allclose(robot.limit("torque"), [12.0, 7.0])


@pytest.mark.parametrize(("n", "effects"), [(2, "armature,backlash"), (5, "")])
def test_an_exported_model_is_the_same_robot(tmp_path, n, effects):
    robot = random_arm(np.random.default_rng(n), n)
    fit = made_fit(robot, effects)
    path = tmp_path / "arm.xml"
    path.write_text(mjcf_text(fit)[0])
    again = lieid.Robot.from_mjcf(path)
    for one, other in zip(robot.joints, again.joints, strict=True):
        np.testing.assert_allclose(one.screw, other.screw, atol=1e-12)
        np.testing.assert_allclose(one.home, other.home, atol=1e-12)
    np.testing.assert_allclose(again.link_parameters, fit.link_parameters, rtol=1e-9, atol=1e-12)


def test_refusals(tmp_path):
    path = tmp_path / "arm.xml"
    path.write_text("<mujoco><worldbody/></mujoco>")
    with pytest.raises(RobotError, match="found no joints"):
        lieid.Robot.from_mjcf(path)
    path.write_text("<mujoco><nonsense/></mujoco>")
    with pytest.raises(RobotError, match="not a MuJoCo model"):
        lieid.Robot.from_mjcf(path)
    one = '<body name="{}"><joint/><geom size="1"/></body>'
    path.write_text(f"<mujoco><worldbody>{one.format('a')}{one.format('b')}</worldbody></mujoco>")
    with pytest.raises(RobotError, match="chains that end at a, b"):
        lieid.Robot.from_mjcf(path)
    assert lieid.Robot.load(path, tip="b").n == 1
    path.write_text(
        "<mujoco><worldbody><body><freejoint/><geom size='1'/></body></worldbody></mujoco>"
    )
    with pytest.raises(RobotError, match="neither a hinge nor a slide"):
        lieid.Robot.from_mjcf(path)
