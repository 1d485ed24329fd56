"""A joint that rests hides no effect elsewhere, and what is not known of it is stated as such."""

import json
from dataclasses import replace

import numpy as np
import pytest
from plant.recordings import recorded

import lieid_casadi as lieid
from lieid_casadi import plant

ROBOT = lieid.robots.two_link()
MODEL = lieid.Model(ROBOT, "coulomb,viscous,offset")
ARM = plant.demo_arm(ROBOT, hidden=None)


def held(arm, seed, joint, **options):
    """Measure an arm along a series in which one joint rests."""
    t = np.arange(0.0, 15.0, 0.002)
    motion = [
        x.copy() for x in plant.FourierTrajectory(ROBOT, base_frequency=1 / 15, seed=seed).at(t)
    ]
    for values, rest in zip(motion, (0.3, 0.0, 0.0), strict=True):
        values[:, joint] = rest
    sensors = plant.demo_sensors(ROBOT)
    return plant.measure_along(arm, t, *motion, sensors=sensors, seed=seed, **options)


def test_a_payload_is_found_beside_a_joint_that_rests():
    fit = lieid.identify(MODEL, recorded(ARM, 1, seconds=15.0))
    loaded = ARM.with_effects(plant.Payload(1.0, (0.02, -0.01, 0.04), 1e-6))
    (step,) = lieid.diagnose(fit, held(loaded, 3, 1)).steps
    assert (step.label, step.joint) == ("payload", 0)
    assert step.confirmed
    assert step.after < 0.2 * step.before


@pytest.fixture(scope="module")
def rested_in_the_test():
    arm = ARM.with_effects(plant.hidden_effect(ARM, "stribeck", 0, strength=2.0))
    return lieid.diagnose(MODEL, recorded(arm, 1, seconds=15.0), held(arm, 2, 0, name="test.csv"))


def test_a_joint_that_rests_in_the_test_confirms_nothing(rested_in_the_test):
    (step,) = rested_in_the_test.steps
    assert (step.label, step.fall.test, step.confirmed) == ("stribeck:1", None, None)
    assert "does not confirm" not in rested_in_the_test.sentence
    json.dumps(rested_in_the_test.to_dict(), allow_nan=False)


def test_what_rests_in_the_test_alone_was_searched(rested_in_the_test):
    assert rested_in_the_test.events == ()


def test_a_test_on_the_training_recording_confirms_nothing():
    arm = ARM.with_effects(plant.hidden_effect(ARM, "stribeck", 0, strength=2.0))
    run = recorded(arm, 1, seconds=15.0, name="a.csv")
    found = lieid.diagnose(MODEL, run, replace(run, name="copy.csv"))
    assert [(step.label, step.confirmed) for step in found.steps] == [("stribeck:1", None)]
    assert found.summary.startswith("On the motion of the training the error")
