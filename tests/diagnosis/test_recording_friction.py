"""What is not the same in all training recordings is stated as such: friction, drifts."""

from dataclasses import replace

import numpy as np
import pytest
from plant.recordings import recorded

import lieid_casadi as lieid
from lieid_casadi import plant

ROBOT = lieid.robots.two_link()
MODEL = lieid.Model(ROBOT, "coulomb,viscous,offset")
RATES = {"first": (0.16, -0.1), "second": (-0.24, 0.1), "third": (0.48, 0.02)}  # N·m/s
MORE = {"coulomb": 1.0, "viscous": 1.0, "offset": 1.0}  # N·m, N·m·s/rad, N·m


def recording(seed, name, more=None):
    """Return a recording of an arm whose joint 1 has more friction of one kind."""
    arm = plant.demo_arm(ROBOT, hidden=None)
    if more is not None:
        value = getattr(arm.friction, more) + np.array([MORE[more], 0.0])
        arm = replace(arm, friction=replace(arm.friction, **{more: value}))
    return recorded(arm, seed, step=0.004, name=name)


@pytest.mark.parametrize("effect", MORE)
def test_friction_that_is_larger_in_one_recording_is_stated(effect):
    train = [recording(1, "first"), recording(2, "second", effect), recording(3, "third")]
    diagnosis = lieid.diagnose(MODEL, train)
    assert not diagnosis.steps
    (found,) = diagnosis.differing
    assert (found.label, found.recording, found.of_model) == (f"{effect}:1", "second", True)
    (value,) = found.parameters.values()
    assert value == pytest.approx(MORE[effect], rel=0.1)
    assert f"in second, {effect} on joint 1 (" in diagnosis.sentence


def test_an_effect_in_one_recording_is_no_rival_of_an_effect_of_the_arm():
    arm = plant.demo_arm(ROBOT, hidden=None)
    arm = arm.with_effects(plant.hidden_effect(arm, "stribeck", 0, strength=0.3))
    t, train = np.arange(0.0, 16.0, 0.002), []
    for seed, speed in ((1, 1.0), (2, 0.4)):  # nearly constant: other friction in one fits as well
        rate = np.array([1.5, 2.1])
        phase = rate * t[:, None] + seed
        dq = speed * np.tanh(6.0 * np.sin(phase))
        ddq = speed * 6.0 * rate * np.cos(phase) / np.cosh(6.0 * np.sin(phase)) ** 2
        motion = (np.cumsum(dq, axis=0) * 0.002, dq, ddq)
        sensors = plant.demo_sensors(ROBOT)
        train.append(plant.measure_along(arm, t, *motion, sensors=sensors, seed=seed))
    (step,) = lieid.diagnose(MODEL, train).steps
    assert step.label == "stribeck:1"
    assert not any("recording" in rival.label for rival in step.rivals)


def test_an_effect_that_one_recording_cannot_show_is_an_effect_of_the_arm():
    arm = plant.demo_arm(ROBOT, hidden=None)
    arm = arm.with_effects(plant.hidden_effect(arm, "viscous_polynomial", 0, strength=2.0))
    t, train = np.arange(0.0, 10.0, 0.004), []
    for seed, scale in ((1, 0.1), (2, 1.0)):
        motion = plant.FourierTrajectory(ROBOT, base_frequency=0.1, seed=seed).at(t)
        sensors = plant.demo_sensors(ROBOT)
        slower = [scale * x for x in motion]
        train.append(plant.measure_along(arm, t, *slower, sensors=sensors, seed=seed))
    diagnosis = lieid.diagnose(MODEL, train)
    assert [step.label for step in diagnosis.steps] == ["viscous_polynomial:1"]
    assert not diagnosis.differing


def test_drifts_of_each_recording_are_stated_beside_the_effect_of_the_arm():
    arm, train = plant.demo_arm(ROBOT, hidden=None), []
    arm = arm.with_effects(plant.hidden_effect(arm, "load_friction", 0, strength=1.0))
    for seed, (name, rates) in enumerate(RATES.items(), start=1):
        drifts = [plant.BiasDrift(joint, rate=rate) for joint, rate in enumerate(rates)]
        train.append(recorded(arm.with_effects(*drifts), seed, step=0.004, name=name))
    diagnosis = lieid.diagnose(MODEL, train)
    assert [step.label for step in diagnosis.steps] == ["load_friction:1"]
    assert diagnosis.verdict == "unexplained"
    found = {(d.label, d.recording): d.parameters["r"] for d in diagnosis.differing}
    for name, rates in RATES.items():
        for joint, rate in enumerate(rates):
            assert found.pop((f"bias_drift:{joint + 1}", name)) == pytest.approx(rate, abs=0.05)
    assert not found
