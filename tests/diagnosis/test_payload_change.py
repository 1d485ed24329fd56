"""A payload on an arm with load friction is named with mass and place, and nothing beside it."""

from dataclasses import replace

import numpy as np
import pytest
from hidden_effects.motions import moves_between
from plant.recordings import recorded

import lieid_casadi as lieid
from lieid_casadi import plant
from lieid_casadi.plant.trajectories import Envelope

ROBOT = lieid.robots.panda()
COM = np.array([0.02, 0.03, 0.08])


def recording(seed, mass=0.0):
    arm = plant.demo_arm(ROBOT, seed=0, hidden=None)
    friction = [plant.hidden_effect(arm, "load_friction", j, strength=1.0) for j in (1, 2, 3)]
    arm = arm.with_effects(*friction, plant.Payload(mass, tuple(COM)))
    return recorded(arm, seed, seconds=12.0)


@pytest.fixture(scope="module")
def fit():
    model = lieid.Model(ROBOT, "coulomb,viscous,offset,load_friction:2+3+4")
    return lieid.identify(model, [recording(1), recording(2)])


def test_a_payload_is_the_only_change(fit):
    found = lieid.diagnose(fit, recording(3, 2.8))
    assert [step.label for step in found.steps] == ["payload"]
    parameters = found.steps[0].parameters
    assert parameters["m"] == pytest.approx(2.8, rel=0.01)
    moment = [parameters[f"mc{x}"] for x in "xyz"]
    np.testing.assert_allclose(np.array(moment) / parameters["m"], COM, atol=2e-3)
    assert "2.8 kg, centre of mass at (20, 30, 80) mm in the tool frame" in found.sentence


def test_friction_that_changed_on_several_joints_is_one_finding(fit):
    run = recording(3)
    less = np.array([0.0, 0.6, 0.0, 0.6, 0.12, 0.0, 0.0])
    found = lieid.diagnose(fit, replace(run, tau=run.tau + less * np.sign(run.dq)))
    assert sorted(step.label for step in found.steps) == ["coulomb:2", "coulomb:4", "coulomb:5"]
    assert {step.group for step in found.steps} == {1}
    assert found.sentence.count("Dry friction on joints 2, 4 and 5 has increased") == 1
    assert "does not model" not in found.sentence


def test_what_the_fit_does_not_model_may_have_acted_before(fit):
    run = recording(3)
    square = np.zeros(7)
    square[3] = 1.0
    found = lieid.diagnose(fit, replace(run, tau=run.tau + square * run.dq * np.abs(run.dq)))
    assert [step.label for step in found.steps] == ["viscous_polynomial:4"]
    assert "The fit does not model viscous_polynomial:4; what its recordings" in found.sentence


def test_parameters_of_a_short_fit_do_not_take_a_change_beyond_their_uncertainty():
    arm = plant.demo_arm(ROBOT, seed=0, hidden=None)
    fit = lieid.identify(
        lieid.Model(ROBOT, "coulomb,viscous,offset"), recorded(arm, 1, seconds=5.0)
    )
    run = recorded(arm, 3, seconds=12.0)
    assert lieid.diagnose(fit, run).steps == ()
    found = lieid.diagnose(fit, replace(run, tau=run.tau + np.array([0, 0, 0, 0, 0.3, 0, 0])))
    assert [step.label for step in found.steps] == ["offset:5"]


@pytest.mark.parametrize(("k", "size"), [(3.0, 8.0), (2.3, 20.0), (4.1, 20.0)])
def test_a_large_ripple_between_two_points_of_its_grid_is_the_only_change(fit, k, size):
    run, ripple = recording(3), np.zeros(7)
    ripple[3] = size
    found = lieid.diagnose(fit, replace(run, tau=run.tau + ripple * np.sin(k * run.q + 1.0)))
    assert [step.label for step in found.steps] == ["torque_ripple:4"]
    assert found.steps[0].parameters["k"] == pytest.approx(k, rel=0.01)


def cycle(arm, seed):
    """Measure an arm that moves between three poses, again and again."""
    random, limits = np.random.default_rng(seed), Envelope.of(ROBOT)
    poses = np.tile(0.5 * random.uniform(limits.lower, limits.upper, (3, 7)), (4, 1))
    motion = moves_between(poses, np.ones(len(poses) - 1), 0.3)
    t = np.arange(0.0, motion.duration, 0.002)
    sensors = plant.Sensors(rate=250.0, torque_noise=0.1)
    return plant.measure_along(arm, t, *motion.at(t), sensors=sensors, seed=seed)


def test_errors_of_uncertain_parameters_are_no_changes_beside_that_of_another_joint():
    arm = plant.demo_arm(ROBOT, seed=0, hidden=None)
    fit = lieid.identify(lieid.Model(ROBOT, "coulomb,viscous,offset"), cycle(arm, 1))
    changed = arm.with_effects(plant.hidden_effect(arm, "load_friction", 1, strength=4.0))
    found = lieid.diagnose(fit, cycle(changed, 11))
    assert [step.label for step in found.steps] == ["load_friction:2"]
