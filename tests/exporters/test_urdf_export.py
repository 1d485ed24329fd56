"""Exported URDFs: their dynamics in Pinocchio are those of the fit."""

import re
from dataclasses import replace
from xml.etree import ElementTree

import numpy as np
import pytest
from plant.recordings import recorded
from real_arms import URDFS

import lieid_casadi as lieid
from lieid_casadi import plant
from lieid_casadi.errors import ExportError
from lieid_casadi.exporters.export import export
from lieid_casadi.recording import Processing

ARM = """<?xml version="1.0" encoding="utf-8"?>
<!-- a comment before -->
<robot name="bench arm">
  <material name="grey"><color rgba="0.5 0.5 0.5 1"/></material>
  <link name="base"><inertial><mass value="9"/><inertia ixx="1" iyy="1" izz="1"
      ixy="0" ixz="0" iyz="0"/></inertial></link>
  <link name="upper">
    <!-- weighed on 3 May > 4 May -->
    <visual><geometry><box size="1 1 1"/></geometry></visual>
    <inertial>
      <origin xyz="0.1 0.02 0.01" rpy="0.3 -0.2 1.57079632679"/>
      <mass value="3.0"/>
      <inertia ixx="0.03" ixy="0.001" ixz="-0.002" iyy="0.02" iyz="0.003" izz="0.035"/>
    </inertial>
  </link>
  <link name="fore"/>
  <link name="flange"/>
  <link name="hand">
    <inertial><origin xyz="0 0 0.05" rpy="0 0 0.4"/><mass value="0.6"/>
      <inertia ixx="0.002" ixy="0" ixz="0" iyy="0.001" iyz="0.0002" izz="0.0015"/></inertial>
  </link>
  <link name="finger"><inertial><mass value="0.1"/>
      <inertia ixx="1e-4" ixy="0" ixz="0" iyy="1e-4" iyz="0" izz="1e-4"/></inertial></link>
  <joint name="shoulder" type="revolute">
    <origin xyz="0 0 0.4" rpy="1.2 0.1 0"/><parent link="base"/><child link="upper"/>
    <axis xyz="0 0.6 0.8"/>
    <limit lower="-2" upper="2" effort="90" velocity="2.5"/>
    <dynamics damping="0.0" friction="0.0" spring="7"/>
  </joint>
  <joint name="elbow" type="continuous">
    <origin xyz="0.4 0 0" rpy="0 0.5 -1.1"/><parent link="upper"/><child link="fore"/>
    <axis xyz="1 0 0"/>
  </joint>
  <joint name="mount" type="fixed">
    <origin xyz="0.1 0.3 0" rpy="0.2 0 0"/><parent link="fore"/><child link="flange"/></joint>
  <joint name="grip" type="fixed">
    <origin xyz="0 0 0.02"/><parent link="flange"/><child link="hand"/></joint>
  <joint name="slide" type="prismatic">
    <origin xyz="0 0.02 0.1" rpy="0 1 0"/><parent link="hand"/><child link="finger"/>
    <axis xyz="0 1 0"/><limit lower="0" upper="0.04" effort="20" velocity="0.1"/></joint>
</robot>
"""
EFFECTS = "coulomb,viscous,offset,armature"


def fitted(robot, seed=0):
    """A feasible fit of an arm whose inertias differ from those of its description."""
    n, ideal = robot.n, plant.Sensors(rate=None)
    friction = plant.JointFriction(np.full(n, 0.4), np.full(n, 0.3), np.zeros(n))
    arm = plant.Arm(robot, plant.perturbed_inertias(robot, spread=0.3, seed=seed), friction)
    recording = recorded(arm, seed, seconds=8.0, step=0.01, sensors=ideal, name="run.csv")
    model = lieid.Model(robot, EFFECTS)
    return lieid.identify(model, recording, method="feasible", processing=Processing(cutoff=8.0))


@pytest.fixture(scope="module")
def bench(tmp_path_factory):
    path = tmp_path_factory.mktemp("urdf") / "arm.urdf"
    path.write_text(ARM)
    robot = lieid.Robot.from_urdf(path, lock=("slide",))
    return fitted(robot)


def heavier(fit, factor):
    """The fit with another body of the fore arm, nominally hand and finger alone."""
    parameters = fit.parameters.copy()
    parameters[10:20] = factor * fit.model.robot.link_parameters[10:20]
    return replace(fit, parameters=parameters)


def pinocchio_torques(path, fit, states):
    """Pinocchio's RNEA on the file: joints of the fit move, others stay at zero."""
    import pinocchio as pin

    model = pin.buildModelFromUrdf(str(path))
    model.gravity.linear = fit.model.robot.gravity
    data, torques = model.createData(), []
    ids = [model.getJointId(joint.name) for joint in fit.model.robot.joints]
    for q, dq, ddq in zip(*states, strict=True):
        place, rate, change = pin.neutral(model), np.zeros(model.nv), np.zeros(model.nv)
        for j, k in enumerate(ids):
            if model.joints[k].nq == 2:  # continuous: cos q, sin q
                place[model.idx_qs[k] : model.idx_qs[k] + 2] = np.cos(q[j]), np.sin(q[j])
            else:
                place[model.idx_qs[k]] = q[j]
            rate[model.idx_vs[k]], change[model.idx_vs[k]] = dq[j], ddq[j]
        tau = pin.rnea(model, data, place, rate, change)
        torques.append([tau[model.idx_vs[k]] for k in ids])
    return model, np.array(torques)


def states_of(robot, count=40):
    rng = np.random.default_rng(7)
    return tuple(rng.normal(0.0, size, (count, robot.n)) for size in (0.8, 1.0, 3.0))


def check_torques(path, fit):
    states = states_of(fit.model.robot)
    expected = fit.compiled.inverse_dynamics(*states, fit.link_parameters)
    size = np.abs(expected).max()
    model, torques = pinocchio_torques(path, fit, states)
    np.testing.assert_allclose(torques, expected, rtol=0.0, atol=1e-8 * size)
    return model


def test_rigid_torques_and_friction_of_pinocchio(bench, tmp_path):
    done = export(bench, tmp_path, to="urdf")
    assert done.files[0].name == "bench_arm.urdf"
    assert any("no element for armature" in note for note in done.notes)
    assert any("URDF has no element for it: offset" in note for note in done.notes)
    model = check_torques(done.files[0], bench)
    own = dict(zip([c.label for c in bench.model.columns], bench.effect_coefficients, strict=True))
    elbow, shoulder = (model.idx_vs[model.getJointId(name)] for name in ("elbow", "shoulder"))
    assert model.damping[elbow] == pytest.approx(own["viscous.f_v:2"], rel=1e-9)
    assert model.friction[shoulder] == pytest.approx(own["coulomb.f_c:1"], rel=1e-9)


def test_everything_else_of_the_file_stays(bench, tmp_path):
    """Without <inertial> of the moving links and <dynamics>, the two texts are the same."""
    text = export(bench, tmp_path, to="urdf").files[0].read_text()

    def rest(xml):
        for link in ("upper", "fore", "hand", "finger"):
            xml = re.sub(
                rf'(<link name="{link}")(/>|>)(.*?)<inertial>.*?</inertial>',
                r"\1>\3",
                xml,
                flags=re.S,
            )
        xml = re.sub(r"<dynamics[^>]*/>", "", xml)
        return re.sub(r"\s+|</link>|/>", "", xml)

    assert rest(text) == rest(ARM)
    assert "<!-- weighed on 3 May > 4 May -->" in text
    assert 'spring="7"' in text
    assert text.startswith(ARM[: ARM.index("<robot")])
    base = text[text.index('<link name="base"') : text.index('<link name="upper"')]
    assert base in ARM


def test_members_keep_their_nominal_inertia_if_possible(bench, tmp_path):
    fit = heavier(bench, 3.0)
    done = export(fit, tmp_path, to="urdf")
    (note,) = [note for note in done.notes if note.startswith("hand, finger")]
    assert (
        note
        == "hand, finger: rigidly attached to fore; the nominal inertia is kept, fore has the rest"
    )
    root = ElementTree.parse(done.files[0]).getroot()
    assert root.find("link[@name='hand']/inertial/mass").get("value") == "0.6"
    mass = float(root.find("link[@name='fore']/inertial/mass").get("value"))
    assert mass == pytest.approx(3 * 0.7 - 0.7, rel=1e-12)
    check_torques(done.files[0], fit)


def test_members_are_scaled_if_the_identified_inertia_is_smaller(bench, tmp_path):
    fit = heavier(bench, 0.4)
    done = export(fit, tmp_path, to="urdf")
    (note,) = [note for note in done.notes if note.startswith("hand, finger")]
    assert "exceeds the identified one and was scaled by 0.2," in note  # half of 0.4
    root = ElementTree.parse(done.files[0]).getroot()
    for name, nominal in (("hand", 0.6), ("finger", 0.1)):
        mass = root.find(f"link[@name='{name}']/inertial/mass").get("value")
        assert float(mass) == pytest.approx(0.2 * nominal, rel=1e-9)
    check_torques(done.files[0], fit)


def test_a_fit_without_certificate_is_refused_with_the_command(bench, tmp_path):
    for fit in (
        replace(bench, method="wls", certificate=None),
        replace(bench, parameters=-bench.parameters),
    ):
        for to in ("urdf", "mjcf"):
            with pytest.raises(
                ExportError, match=r"feasible: lieid identify ROBOT run\.csv"
            ) as why:
                export(fit, tmp_path / "out", to=to)
            assert "--effects coulomb,viscous,offset,armature --method feasible" in str(why.value)
    assert not (tmp_path / "out").exists()


def test_a_robot_that_is_not_from_a_urdf_needs_one(tmp_path):
    fit = fitted(lieid.robots.two_link())
    with pytest.raises(ExportError, match=r"two_link: not a URDF; .*--into FILE"):
        export(fit, tmp_path / "out", to="urdf")


@pytest.mark.real
@pytest.mark.parametrize(("path", "lock"), URDFS)
def test_urdfs_of_real_arms(path, lock, tmp_path):
    fit = fitted(lieid.Robot.from_urdf(path, lock=lock))
    check_torques(export(fit, tmp_path, to="urdf").files[0], fit)


@pytest.mark.parametrize("case", ["compensated", "small motion"])
def test_a_gravity_load_that_the_recording_did_not_show_is_refused(case):
    """Torque without gravity, and motion of a hundredth of a radian beside noise of 1 N·m."""
    robot, t = lieid.robots.two_link(), np.arange(0.0, 20.0, 0.01)
    size = 1.0 if case == "compensated" else 0.01
    angle, rate = np.outer(t, [1.3, 2.1]), size * np.array([1.3, 2.1])
    q, dq, ddq = size * np.sin(angle), rate * np.cos(angle), -rate * [1.3, 2.1] * np.sin(angle)
    arm = lieid.compile(lieid.Model(robot))
    tau = arm.inverse_dynamics(q, dq, ddq, robot.link_parameters)
    noise = np.random.default_rng(0).normal(size=tau.shape)
    if case == "compensated":
        tau, noise = tau - arm.gravity(q, robot.link_parameters), 0.05 * noise
    recording = lieid.Recording.from_arrays(t, q, dq, tau + noise)
    bare = replace(robot, joints=tuple(replace(j, link=None) for j in robot.joints), source=None)
    model = lieid.Model(robot if case == "compensated" else bare)
    fit = lieid.identify(model, recording, method="feasible", processing=Processing(cutoff=8.0))
    with pytest.raises(ExportError, match="did not show the gravity load of joint"):
        lieid.export(fit, "unused", to="urdf")
