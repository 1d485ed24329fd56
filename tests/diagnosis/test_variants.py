"""Variants of an effect compete with it, and are tried again when later effects join."""

import numpy as np
from workbench.two_link_files import write_recordings

import lieid_casadi as lieid
from lieid_casadi import plant

ROBOT = lieid.robots.two_link()
MODEL = lieid.Model(ROBOT, "coulomb,viscous,offset")
SCALE = plant.torque_scale(ROBOT)[0]


def diagnosis_of(torque):
    arm = plant.demo_arm(ROBOT, hidden=None).with_effects(plant.ForeignTorque(0, torque))
    motion = plant.FourierTrajectory(ROBOT, base_frequency=0.05, seed=1)
    t = np.arange(0.0, 20.0, 0.002)
    sensors = plant.demo_sensors(ROBOT)
    return lieid.diagnose(
        MODEL, plant.measure_along(arm, t, *motion.at(t), sensors=sensors, seed=1)
    )


def test_friction_with_the_square_of_the_load_is_named_with_its_option():
    diagnosis = diagnosis_of(lambda s: 0.1 * s.load[..., 0] ** 2 / SCALE * s.sign[..., 0])
    (step,) = diagnosis.steps
    assert (step.label, step.effect) == ("load_friction/square:1", "load_friction")
    assert "(load_friction/square: " in diagnosis.sentence
    assert "1/(N·m)" in diagnosis.sentence
    reasons = dict(diagnosis.rejected)
    assert "has a smaller held-out error in its place" in reasons["load_friction:1"]


def test_the_simple_form_is_kept_where_it_is_the_right_one():
    diagnosis = diagnosis_of(lambda s: 0.1 * np.abs(s.load[..., 0]) * s.sign[..., 0])
    assert [step.label for step in diagnosis.steps] == ["load_friction:1"]


def test_a_variant_must_be_better_on_every_held_out_part(tmp_path):
    """Two coefficients, when driving and when driven, fitted 15 s better and another run worse."""
    write_recordings(tmp_path)
    train, test = (lieid.Recording.load(tmp_path / f"{name}.npz") for name in ("train", "test"))
    diagnosis = lieid.diagnose(MODEL, train, test)
    assert [step.label for step in diagnosis.steps] == ["load_friction:1"]
    assert diagnosis.to_dict()["steps"][0]["rms_test_moving"][0] < 0.06


def test_a_variant_that_contains_another_accepted_effect_does_not_compete():
    """Friction with hysteresis and load: two effects, not one effect and a variant of the other."""
    arm = plant.demo_arm(ROBOT, hidden=None).with_effects(
        plant.LoadFriction(0, gain=0.1), plant.Presliding(0, width=0.03)
    )
    motion = plant.FourierTrajectory(ROBOT, base_frequency=0.05, seed=1)
    t = np.arange(0.0, 20.0, 0.002)
    train = plant.measure_along(arm, t, *motion.at(t), sensors=plant.demo_sensors(ROBOT), seed=1)
    labels = {step.label for step in lieid.diagnose(MODEL, train).steps}
    assert "presliding:1" in labels
    assert "load_friction:1" in labels
