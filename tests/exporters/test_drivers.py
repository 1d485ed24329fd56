"""Exports for drivers and simulators' configurations: Isaac Lab, Universal Robots."""

import dataclasses
import sys
import types

import numpy as np
import pytest
import yaml
from exporters.c_arms import made_fit
from robot.random_arms import random_arm

import lieid_casadi as lieid
from lieid_casadi.errors import ExportError


def actuators(path, monkeypatch):
    """Run the file with a stand-in for Isaac Lab."""
    stub = types.ModuleType("isaaclab.actuators")
    stub.ImplicitActuatorCfg = dict
    monkeypatch.setitem(sys.modules, "isaaclab", types.ModuleType("isaaclab"))
    monkeypatch.setitem(sys.modules, "isaaclab.actuators", stub)
    scope = {}
    exec(compile(path.read_text(), str(path), "exec"), scope)
    return scope["ACTUATORS"]["arm"]


def test_isaaclab_has_armature_and_friction_of_each_joint(tmp_path, monkeypatch):
    fit = made_fit(lieid.robots.two_link(), "coulomb,viscous,armature,offset")
    made = lieid.export(fit, tmp_path / "out", to="isaaclab")
    arm = actuators(made.files[0], monkeypatch)
    values = dict(zip([c.label for c in fit.model.columns], fit.effect_coefficients, strict=True))
    assert arm["joint_names_expr"] == ["shoulder", "elbow"]
    for j, name in enumerate(("shoulder", "elbow"), start=1):
        assert arm["armature"][name] == values[f"armature.I_a:{j}"]
        assert arm["friction"][name] == pytest.approx(values[f"coulomb.f_c:{j}"], rel=1e-9)
        assert arm["viscous_friction"][name] == pytest.approx(values[f"viscous.f_v:{j}"], rel=1e-9)
        assert arm["stiffness"][name] == 0.0
    assert arm["dynamic_friction"] == arm["friction"]
    assert any("constant torque of offset" in note for note in made.notes)


def test_isaaclab_states_what_it_approximates_and_drives(tmp_path, monkeypatch):
    robot = lieid.robots.two_link().with_drives(lieid.Drive(stiffness=30.0, damping=2.0))
    fit = made_fit(robot, "coulomb,load_friction:2")
    made = lieid.export(fit, tmp_path / "out", to="isaaclab")
    assert sum("RMS error" in note for note in made.notes) == 1
    arm = actuators(made.files[0], monkeypatch)
    assert arm["stiffness"] == {"shoulder": 30.0, "elbow": 30.0}
    assert arm["damping"] == {"shoulder": 2.0, "elbow": 2.0}


def test_the_back_emf_of_a_servo_is_friction_that_no_limit_of_the_actuator_affects(
    tmp_path, monkeypatch
):
    law = lieid.servo_drive("sts3215", derivative=0.3)
    fit = made_fit(lieid.robots.two_link().with_drives(law), "torque_saturation:1")
    made = lieid.export(fit, tmp_path / "out", to="isaaclab")
    arm, limited = actuators(made.files[0], monkeypatch), fit.model.robot.drives[1]
    assert arm["damping"]["elbow"] == limited.derivative == 0.3
    assert arm["viscous_friction"]["elbow"] == pytest.approx(limited.damping)
    assert arm["effort_limit_sim"]["elbow"] == limited.proportional_limit
    assert arm["effort_limit_sim"]["shoulder"] == pytest.approx(limited.stiffness * fit.shapes[0])
    assert not any("not exported" in note for note in made.notes)


@pytest.mark.parametrize("driven", [False, True])
def test_mjlab_has_an_actuator_of_each_joint(tmp_path, monkeypatch, driven):
    robot = lieid.robots.two_link()
    if driven:
        robot = robot.with_drives(lieid.Drive(stiffness=30.0, damping=2.0))
    fit = made_fit(robot, "coulomb,viscous,armature")
    made = lieid.export(fit, tmp_path / "out", to="isaaclab")
    stub = types.ModuleType("mjlab.actuator")
    for name in ("BuiltinMotorActuatorCfg", "BuiltinPositionActuatorCfg"):
        setattr(stub, name, lambda name=name, **fields: {"kind": name, **fields})
    monkeypatch.setitem(sys.modules, "mjlab", types.ModuleType("mjlab"))
    monkeypatch.setitem(sys.modules, "mjlab.actuator", stub)
    scope = {}
    exec(compile(made.files[1].read_text(), "mjlab.py", "exec"), scope)
    values = dict(zip([c.label for c in fit.model.columns], fit.effect_coefficients, strict=True))
    for j, actuator in enumerate(scope["ACTUATORS"]):
        assert actuator["target_names_expr"] == (("shoulder", "elbow")[j],)
        assert actuator["armature"] == values[f"armature.I_a:{j + 1}"]
        assert actuator["frictionloss"] == pytest.approx(values[f"coulomb.f_c:{j + 1}"], rel=1e-9)
        assert actuator["effort_limit"] == robot.limit("torque")[j]
        assert ("Position" in actuator["kind"]) == driven
        assert actuator.get("stiffness") == (30.0 if driven else None)
    assert sum("mjlab has no field for viscous friction" in note for note in made.notes) == 2


def six_joints(viscous, coulomb):
    fit = made_fit(random_arm(np.random.default_rng(4), 6), "coulomb,viscous")
    parameters = fit.parameters.copy()
    parameters[60:] = [*coulomb, *viscous]
    return dataclasses.replace(
        fit, parameters=parameters, values=fit.model.base.combination @ parameters
    )


def test_ur_friction_is_added_by_the_controller(tmp_path):
    viscous, coulomb = np.full(6, 5.0), np.full(6, 2.0)
    made = lieid.export(six_joints(viscous, coulomb), tmp_path / "ur", to="ur-friction")
    data = yaml.safe_load(made.files[0].read_text())
    assert data["parameters"] == {"viscous_scale": [0.0] * 6, "coulomb_scale": [0.0] * 6}
    np.testing.assert_allclose(data["identified"]["viscous"], viscous, rtol=1e-9)
    np.testing.assert_allclose(data["identified"]["coulomb"], coulomb, rtol=1e-9)


def test_misuse_is_named(tmp_path):
    fit = made_fit(lieid.robots.two_link(), "coulomb")
    with pytest.raises(ExportError, match="expected 6"):
        lieid.export(fit, tmp_path / "ur", to="ur-friction")
    with pytest.raises(ExportError, match="did you mean export"):
        lieid.export(fit, "c", tmp_path / "arm")
