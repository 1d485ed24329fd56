"""Cost of leaving an effect out of a model, compared with models without its columns."""

import numpy as np
import pytest

import lieid_casadi as lieid
from lieid_casadi import plant
from lieid_casadi.diagnosis import DiagnosisOptions
from lieid_casadi.diagnosis.screening.context import ScreeningContext
from lieid_casadi.diagnosis.search.pruning import baseline_without, redundant_effects
from lieid_casadi.recording import process


@pytest.fixture(scope="module")
def context():
    robot = lieid.robots.two_link()
    arm = plant.demo_arm(robot, hidden=None)
    arm = arm.with_effects(plant.hidden_effect(arm, "stribeck", 0, strength=2.0))
    trajectory = plant.FourierTrajectory(robot, base_frequency=0.1, seed=1)
    t = np.arange(0.0, 10.0, 0.005)
    recording = plant.measure_along(arm, t, *trajectory.at(t), sensors=plant.demo_sensors(robot))
    fit = lieid.identify(lieid.Model(robot, "coulomb,viscous,stribeck,position_spring"), recording)
    segments = process(recording, fit.processing)
    return ScreeningContext.of(fit, segments, DiagnosisOptions(), with_candidates=False)


@pytest.mark.parametrize("part", [0.0, 0.03])
def test_redundant_effects_are_those_without_which_the_model_fits_as_well(context, part):
    noise, placements = context.white_noise, context.fit.model.placements
    full = context.baseline(noise)
    costs, expected = {}, set()
    for placement in placements:
        smaller = baseline_without(context, noise, placement)
        costs[placement.label] = np.sum(smaller.residual**2) - np.sum(full.residual**2)
        count = len(placement.effect.coefficients) + len(placement.effect.shapes)
        rows = len(context.torque[placement.joint])
        if costs[placement.label] < max(count * np.log(full.rows), part * rows):
            expected.add(placement.label)
    found = [p.label for p in redundant_effects(context, noise, placements, part)]
    assert set(found) == expected
    assert "stribeck:1" not in expected
    assert "position_spring:1" in expected
    assert found == sorted(found, key=costs.get)  # the weakest first
