"""Drifts that differ between the training recordings are stated, each with its own rate."""

import numpy as np
import pytest

import lieid_casadi as lieid
from lieid_casadi import plant

ROBOT = lieid.robots.two_link()
MODEL = lieid.Model(ROBOT, "coulomb,viscous,offset")
RATES = {"first": (0.16, -0.1), "second": (-0.24, 0.1), "third": (0.48, 0.02)}  # N·m/s


def recording(seed, name, rates):
    arm = plant.demo_arm(ROBOT, hidden=None)
    drifts = [plant.BiasDrift(joint, rate=rate) for joint, rate in enumerate(rates)]
    arm = arm.with_effects(plant.hidden_effect(arm, "load_friction", 0, strength=1.0), *drifts)
    motion = plant.FourierTrajectory(ROBOT, base_frequency=0.1, seed=seed)
    t = np.arange(0.0, 10.0, 0.004)
    sensors = plant.demo_sensors(ROBOT)
    return plant.measure_along(arm, t, *motion.at(t), sensors=sensors, seed=seed, name=name)


def test_drifts_of_each_recording_are_stated_beside_the_effect_of_the_arm():
    train = [recording(k + 1, name, rates) for k, (name, rates) in enumerate(RATES.items())]
    diagnosis = lieid.diagnose(MODEL, train)
    assert [step.label for step in diagnosis.steps] == ["load_friction:1"]
    assert diagnosis.verdict == "unexplained"
    found = {(d.label, d.recording): d.parameters["r"] for d in diagnosis.differing}
    for name, rates in RATES.items():
        for joint, rate in enumerate(rates):
            assert found.pop((f"bias_drift:{joint + 1}", name)) == pytest.approx(rate, abs=0.05)
    assert not found
    assert "in first, bias_drift on joint 1 (" in diagnosis.sentence
