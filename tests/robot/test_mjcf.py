"""Robots from MuJoCo models."""

import mujoco
import numpy as np
import pytest
from exporters.c_arms import made_fit
from robot.random_arms import random_arm

import lieid_casadi as lieid
from lieid_casadi.errors import LockedBranchWarning, MissingMeshWarning, NotReadWarning, RobotError
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
    again = lieid.Robot.load(path)
    for one, other in zip(robot.joints, again.joints, strict=True):
        np.testing.assert_allclose(one.screw, other.screw, atol=1e-12)
        np.testing.assert_allclose(one.home, other.home, atol=1e-12)
    np.testing.assert_allclose(again.link_parameters, fit.link_parameters, rtol=1e-9, atol=1e-12)


def test_refusals(tmp_path):
    path = tmp_path / "arm.xml"
    path.write_text("<mujoco><worldbody/></mujoco>")
    with pytest.raises(RobotError, match="found no joints"):
        lieid.Robot.load(path)
    path.write_text("<mujoco><nonsense/></mujoco>")
    with pytest.raises(RobotError, match="not a MuJoCo model"):
        lieid.Robot.load(path)
    one = '<body name="{}"><joint/><geom size="1"/></body>'
    path.write_text(f"<mujoco><worldbody>{one.format('a')}{one.format('b')}</worldbody></mujoco>")
    with pytest.raises(RobotError, match="chains that end at a, b"):
        lieid.Robot.load(path)
    assert lieid.Robot.load(path, tip="b").n == 1
    path.write_text(
        "<mujoco><worldbody><body><freejoint/><geom size='1'/></body></worldbody></mujoco>"
    )
    with pytest.raises(RobotError, match="neither a hinge nor a slide"):
        lieid.Robot.load(path)


def model(body="", assets="", more="", joint=""):
    """A model of one link, for what MuJoCo's documentation allows besides."""
    return (
        f'<mujoco><compiler angle="radian"/><asset>{assets}</asset><worldbody><body name="link">'
        f'<joint name="j" axis="0 0 1" {joint}/><inertial pos="0.1 0 0" mass="2" '
        f'diaginertia="1 1 1"/>{body}</body></worldbody>{more}</mujoco>'
    )


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (model('<replicate count="100000000"><geom size="0.1"/></replicate>'), "<replicate> asks"),
        (
            model('<replicate count="1000">' * 3 + '<geom size="0.1"/>' + "</replicate>" * 3),
            r"<replicate> asks for 1e\+06",
        ),
        (model('<composite type="cable" count="100000 1 1"/>'), "<composite> asks"),
        (model(assets='<hfield name="h" nrow="30000" ncol="30000" size="1 1 1 1"/>'), "<hfield>"),
        (model(assets='<texture type="2d" width="60000" height="60000"/>'), "<texture> asks"),
        (model(assets='<model name="m" file="arm.xml"/>'), "attaches itself"),
        (model(more='<include file="arm.xml"/>'), "attaches itself"),
        ('<!DOCTYPE m [<!ENTITY a "b">]><mujoco/>', "entity definition"),
    ],
)
def test_models_that_ask_for_too_much_are_refused(tmp_path, text, message):
    path = tmp_path / "arm.xml"
    path.write_text(text)
    with pytest.raises(RobotError, match=message):
        lieid.Robot.load(path)


def test_an_attached_model_is_read(tmp_path):
    (tmp_path / "hand.xml").write_text(
        '<mujoco><worldbody><body name="palm"><inertial pos="0 0 0" mass="3" '
        'diaginertia="1 1 1"/></body></worldbody></mujoco>'
    )
    (tmp_path / "arm.xml").write_text(
        model(
            '<attach model="m" body="palm" prefix="x_"/>',
            '<model name="m" file="hand.xml"/>',
        )
    )
    assert lieid.Robot.load(tmp_path / "arm.xml").link_parameters[0] == pytest.approx(5.0)


def test_a_gear_multiplies_stiffness_by_its_square(tmp_path):
    path = tmp_path / "arm.xml"
    actuator = '<position joint="j" kp="15" kv="1" gear="2" forcerange="-3 3"/>'
    path.write_text(model(more=f"<actuator>{actuator}</actuator>"))
    (joint,) = lieid.Robot.load(path).joints
    # the torque of MuJoCo itself at a command of zero
    simulated = mujoco.MjModel.from_xml_path(str(path))
    data = mujoco.MjData(simulated)
    data.qpos[0], data.qvel[0] = 0.05, 0.1
    mujoco.mj_forward(simulated, data)
    np.testing.assert_allclose(joint.drive.torque(-0.05, 0.1), data.qfrc_actuator[0])
    data.qpos[0] = -1.0
    mujoco.mj_forward(simulated, data)
    assert joint.limits.torque == pytest.approx(data.qfrc_actuator[0])


TENDON = '<tendon><fixed name="t" stiffness="2"><joint joint="j" coef="1"/></fixed></tendon>'


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"joint": 'stiffness="5" springref="0.3"'}, ["spring of joint j", "5", "0.3"]),
        (
            {"more": '<actuator><position joint="j" kp="9" timeconst="0.1"/></actuator>'},
            ["time constant", "0.1"],
        ),
        (
            {
                "more": '<actuator><intvelocity name="v" joint="j" kp="9" actrange="-1 1"/>'
                "</actuator>"
            },
            ["actuator v (its integrator"],
        ),
        (
            {"body": '<body name="b" gravcomp="1"><geom size="0.1"/></body>'},
            ["gravcomp = 1 of body b"],
        ),
        (
            {"more": '<equality><connect name="bar" body1="link" anchor="0.1 0 0"/></equality>'},
            ["equality constraint bar"],
        ),
        (
            {"more": TENDON + '<equality><tendon tendon1="t"/></equality>'},
            ["equality constraint 1", "tendon t"],
        ),
        (
            {"more": TENDON + '<actuator><position name="p" tendon="t" kp="9"/></actuator>'},
            ["tendon t", "actuator p (its transmission)"],
        ),
        ({"more": '<option density="1000"/>'}, ["the fluid"]),
    ],
)
def test_what_is_not_read_is_named(tmp_path, changes, words):
    path = tmp_path / "arm.xml"
    path.write_text(model(**changes))
    robot = lieid.Robot.load(path)
    (warning,) = robot.warnings
    assert isinstance(warning, NotReadWarning)
    assert all(word in str(warning) for word in words)
    assert (robot.drives is None) == ("timeconst" not in str(changes))


def test_a_velocity_servo_beside_a_position_servo_is_named(tmp_path):
    servos = '<velocity name="v" joint="j" kv="3"/><position joint="j" kp="9" kv="1"/>'
    path = tmp_path / "arm.xml"
    path.write_text(model(more=f"<actuator>{servos}</actuator>"))
    robot = lieid.Robot.load(path)
    assert robot.joints[0].drive == Drive(stiffness=9.0, damping=1.0)
    assert "actuator v, a further one of joint j" in str(robot.warnings[0])


@pytest.mark.parametrize(
    ("joint", "more"),
    [
        ('ref="0.4" range="-1 2"', ""),
        ('range="-1 2"', '<option><flag gravity="disable"/></option>'),
    ],
    ids=["another angle at rest", "without gravity"],
)
def test_angles_and_gravity_are_those_of_the_model(tmp_path, joint, more):
    path = tmp_path / "arm.xml"
    path.write_text(model(more=more, joint=joint).replace("0 0 1", "0 1 0"))
    robot, (q, dq, ddq) = lieid.Robot.load(path), np.array([[0.7], [0.3], [-0.5]])
    arm = lieid.compile(robot)
    found = arm.inverse_dynamics(q[None], dq[None], ddq[None], robot.link_parameters)
    np.testing.assert_allclose(found[0], torque(path, q, dq, ddq), atol=1e-9)
    assert robot.limit("position_upper") == 2.0


def test_a_missing_mesh_is_no_obstacle(tmp_path):
    assets = '<mesh name="m" file="none.stl"/><texture type="2d" name="t" file="none.png"/>'
    assets += '<material name="red" texture="t"/><hfield name="h" file="none.png" size="1 1 1 1"/>'
    path = tmp_path / "arm.xml"
    path.write_text(
        model(
            '<geom type="mesh" mesh="m" material="red"/><geom size="0.1" material="red"/>'
            '<site name="s" material="red"/>',
            assets,
        )
    )
    robot = lieid.Robot.load(path)
    (warning,) = robot.warnings
    assert isinstance(warning, MissingMeshWarning)
    assert "none.stl" in str(warning)
    assert robot.link_parameters[0] == 2.0


FINGERS = """<body name="hand" pos="0 0 0.2"><joint name="wrist" axis="1 0 0"/>
 <inertial pos="0 0 0.05" mass="1" diaginertia="0.1 0.1 0.1"/>
 <body name="left"><joint name="fl" type="slide" axis="0 1 0"/>
  <inertial pos="0 0 0.1" mass="0.1" diaginertia="0.01 0.01 0.01"/></body>
 <body name="right"><joint name="fr" type="slide" axis="0 -1 0"/>
  <inertial pos="0 0 0.1" mass="0.1" diaginertia="0.01 0.01 0.01"/></body></body>"""
COUPLED = """<equality><joint joint1="fl" joint2="fr"/></equality>
<tendon><fixed name="split" stiffness="1"><joint joint="fl" coef="1"/></fixed></tendon>
<actuator><general tendon="split"/></actuator>"""
KEY = '<keyframe><key qpos="0.4 0.5 0.03 0.01"/></keyframe>'


@pytest.mark.parametrize("options", [{"tip": "hand"}, {"lock": ["fl", "fr"]}])
def test_fingers_are_locked_at_the_keyframe_and_add_their_mass(tmp_path, options):
    path = tmp_path / "arm.xml"
    path.write_text(model(FINGERS, more=KEY + COUPLED))
    robot = lieid.Robot.load(path, **options)
    assert [joint.name for joint in robot.joints] == ["j", "wrist"]
    (warning,) = robot.warnings
    assert isinstance(warning, LockedBranchWarning)
    assert "fl, fr are locked at the first keyframe" in str(warning)
    assert "0.2 kg" in str(warning)
    # torque of MuJoCo's full model, whose fingers are held in the keyframe
    arm, random = lieid.compile(robot), np.random.default_rng(0)
    q, dq, ddq = random.uniform(-1.0, 1.0, (3, 2))
    full = torque(path, [*q, 0.03, 0.01], [*dq, 0, 0], [*ddq, 0, 0])
    found = arm.inverse_dynamics(*np.array([q, dq, ddq])[:, None], robot.link_parameters)[0]
    np.testing.assert_allclose(found, full[:2], rtol=1e-9)
