"""Exported MuJoCo models have the dynamics of the fit."""

import re
from dataclasses import replace
from xml.etree import ElementTree

import mujoco
import numpy as np
import pytest
from exporters.c_arms import made_fit, torque_of
from exporters.test_urdf_export import ARM
from robot.random_arms import random_arm

import lieid_casadi as lieid
from lieid_casadi.exporters.mjcf import mjcf_text
from lieid_casadi.robot.drive import Drive

SO101 = lieid.robots.so101().with_drives(lieid.servo_drive("sts3215"))
RANDOM = random_arm(np.random.default_rng(3), 5)


def model_of(fit):
    """Return the exported model, and the notes."""
    text, notes = mjcf_text(fit)
    return mujoco.MjModel.from_xml_string(text), notes


def inverse(model, q, dq, ddq):
    """Return MuJoCo's torque for a motion, without friction loss, which has no inverse."""
    data = mujoco.MjData(model)
    data.qpos[:], data.qvel[:], data.qacc[:] = q, dq, ddq
    mujoco.mj_inverse(model, data)
    return data.qfrc_inverse.copy()


def motions(robot, count=30):
    """Return motions (count, 3, n) within the position limits."""
    random = np.random.default_rng(1)
    low = np.nan_to_num(robot.limit("position_lower"), nan=-2.0)
    high = np.nan_to_num(robot.limit("position_upper"), nan=2.0)
    q = random.uniform(low, high, (count, robot.n))
    return np.stack([q, *random.normal(size=(2, count, robot.n))], axis=1)


@pytest.mark.parametrize(
    "robot",
    [SO101, lieid.robots.panda(), lieid.Robot.parse_urdf(ARM), RANDOM],
    ids=["so101", "panda", "urdf", "random"],
)
def test_rigid_torque(robot):
    fit = made_fit(robot, "")
    model, notes = model_of(fit)
    model.dof_damping[:] = 0.0  # of the servo's motor
    assert not any("approximated" in note for note in notes)
    for q, dq, ddq in motions(robot):
        expected = fit.compiled.inverse_dynamics(q[None], dq[None], ddq[None], fit.link_parameters)
        np.testing.assert_allclose(
            inverse(model, q, dq, ddq), expected[0], rtol=0, atol=1e-9 * np.abs(expected).max()
        )


def test_torque_of_effects_that_mujoco_has():
    fit = made_fit(lieid.robots.panda(), "viscous,offset,armature,position_spring:2")
    model, notes = model_of(fit)
    assert notes == []
    for q, dq, ddq in motions(fit.model.robot):
        expected = torque_of(fit, q[None], dq[None], ddq[None])[0]
        np.testing.assert_allclose(inverse(model, q, dq, ddq), expected, rtol=1e-5, atol=1e-5)


def test_dry_friction_holds_a_load():
    """With MuJoCo's default constraint a joint creeps under a torque below its friction loss."""
    text, _ = mjcf_text(made_fit(lieid.robots.two_link(), "coulomb"))
    default = re.sub(r' sol(ref|imp)friction="[^"]*"', "", text)
    creep = []
    for source in (text, default):
        model = mujoco.MjModel.from_xml_string(source)
        model.opt.gravity[:] = 0.0
        data = mujoco.MjData(model)
        data.qfrc_applied[1] = 0.8 * model.dof_frictionloss[1]
        for _ in range(500):
            mujoco.mj_step(model, data)
        creep.append(abs(data.qvel[1]))
    assert creep[0] < 0.03 * creep[1]


def test_other_friction_is_approximated_and_the_error_stated():
    fit = made_fit(lieid.robots.panda(), "coulomb,viscous,load_friction:2,stribeck:3,presliding:4")
    _, notes = model_of(fit)
    about = [note for note in notes if "friction approximated" in note]
    assert [note.split(":")[0] for note in about] == ["joint 2", "joint 3"]
    assert all("RMS error" in note and "% of the friction" in note for note in about)


def test_the_stated_error_is_that_of_the_friction():
    """Monte Carlo of the same rule, with the formula of load friction written out."""
    robot = lieid.robots.two_link()
    fit = made_fit(robot, "coulomb,load_friction:2")
    from lieid_casadi.exporters.simulator_joints import linear_friction

    found = linear_friction(fit)[1]
    random = np.random.default_rng(5)
    q = random.uniform(-2.5, 2.5, (20000, 2))
    load = fit.compiled.inverse_dynamics(q, 0 * q, 0 * q, fit.link_parameters)[:, 1]
    f_c, f_tau = fit.effect_coefficients[1], fit.effect_coefficients[2]
    friction = f_c + f_tau * np.abs(load)
    assert found.loss == pytest.approx(friction.mean(), rel=0.1)
    assert found.error == pytest.approx(friction.std(), rel=0.15)


def test_actuators_of_a_servo_follow_its_law():
    laws = SO101.with_drives(lieid.servo_drive("sts3215", derivative=0.2))
    fit = made_fit(laws, "coulomb")
    model, _ = model_of(fit)
    model.dof_frictionloss[:] = 0.0
    assert [model.actuator(j).name for j in range(6)] == [j.name for j in SO101.joints]
    random, data = np.random.default_rng(0), mujoco.MjData(model)
    for error in (0.1, 3.0):
        q, dq = random.uniform(-1.0, 1.0, (2, 6))
        data.qpos[:], data.qvel[:], data.ctrl[:] = q, dq, q + error * random.choice([-1, 1], 6)
        mujoco.mj_forward(model, data)
        force = data.qfrc_actuator + data.qfrc_passive
        expected = [
            joint.drive.torque(e, v)
            for joint, e, v in zip(laws.joints, data.ctrl - q, dq, strict=True)
        ]
        np.testing.assert_allclose(force, expected, atol=1e-9)


def test_actuators_of_a_pd_controller_and_motors():
    robot = lieid.robots.two_link()
    model, _ = model_of(made_fit(robot.with_drives(Drive(stiffness=50.0, damping=3.0)), ""))
    np.testing.assert_allclose(model.actuator_gainprm[:, 0], 50.0)
    np.testing.assert_allclose(model.actuator_biasprm[:, 1:3], [[-50.0, -3.0]] * 2)
    np.testing.assert_allclose(model.actuator_forcerange, [[-40, 40], [-15, 15]])
    model, _ = model_of(made_fit(robot, ""))
    np.testing.assert_allclose(model.actuator_ctrlrange, [[-40, 40], [-15, 15]])


def test_delay_and_saturation_of_drives():
    robot = lieid.robots.two_link().with_drives(Drive(stiffness=50.0))
    fit = made_fit(robot, "command_delay:2,torque_saturation:1")
    model, notes = model_of(fit)
    delay = fit.effect_coefficients[0]
    np.testing.assert_allclose(model.actuator_delay, [0.0, delay + 0.5 * model.opt.timestep])
    assert model.actuator_forcerange[0, 1] == pytest.approx(min(40.0, 50.0 * fit.shapes[0]))
    assert any("command delays" in note for note in notes)


def test_a_play_is_a_joint_between_motor_and_link():
    """A motor within its play moves only its armature; a link there falls freely."""
    robot = lieid.robots.two_link().with_drives(Drive(stiffness=50.0))
    fit = made_fit(robot, "armature,backlash:2")
    names = [c.name for c in fit.model.columns]
    rotor, width = (dict(zip(names[1:], fit.effect_coefficients[1:], strict=True))[name]
                    for name in ("armature.I_a", "backlash.b"))  # fmt: skip
    model, notes = model_of(fit)
    assert [model.joint(k).name for k in range(3)] == ["shoulder", "elbow", "elbow_play"]
    assert [model.actuator(k).name for k in range(model.nu)] == ["shoulder", "elbow"]
    np.testing.assert_allclose(model.jnt_range[2], [-width / 2, width / 2])
    assert any(note.startswith(f"joint 2: a play of {width:.4g} rad") for note in notes)
    data, torque = mujoco.MjData(model), 0.7
    data.qfrc_applied[1] = torque
    mujoco.mj_forward(model, data)
    q, dq = data.qpos[None, :2], data.qvel[None, :2]
    links = np.array([[data.qacc[0], data.qacc[1] + data.qacc[2]]])
    load = fit.compiled.inverse_dynamics(q, dq, links, fit.link_parameters)[0]
    assert load[1] == pytest.approx(0.0, abs=1e-9)
    assert rotor * data.qacc[1] == pytest.approx(torque, rel=1e-9)


def test_a_play_without_a_rotor_is_not_exported():
    robot = lieid.robots.two_link().with_drives(Drive(stiffness=50.0))
    model, notes = model_of(made_fit(robot, "coulomb,backlash:2"))
    assert model.nv == 2
    assert "not part of the MuJoCo model: backlash" in notes


@pytest.mark.parametrize(
    "name",
    ["a--b", "a---><evil/>", "ends with -", "<![CDATA[ & ]]>", "\x07 \x1b[2J\u202e", "new\nline"],
)
def test_names_stay_text(name):
    robot = lieid.robots.two_link()
    joints = tuple(replace(joint, name=f"{name}{k}") for k, joint in enumerate(robot.joints))
    text, _ = mjcf_text(made_fit(replace(robot, name=name, joints=joints), "coulomb,armature"))
    root = ElementTree.fromstring(text)
    assert {e.tag for e in root} == {"compiler", "option", "worldbody", "actuator"}
    assert mujoco.MjModel.from_xml_string(text).nu == 2
