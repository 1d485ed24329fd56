"""Block bootstrap of the screening: gains of resampled blocks, and rivals of unstable effects."""

from dataclasses import replace

import numpy as np
import pytest

import lieid_casadi as lieid
from lieid_casadi import plant
from lieid_casadi.diagnosis import DiagnosisOptions
from lieid_casadi.diagnosis.screening.candidates import Candidate
from lieid_casadi.diagnosis.search.block_bootstrap import Competitor
from lieid_casadi.effects import Placement, make

ROWS, BLOCKS = 300, 10
STRIBECK = Candidate(Placement(make("stribeck"), 0), np.ones((1, 1)))


def competitor(columns, least=0.0):
    return Competitor(STRIBECK, columns, least)


def test_scores_are_penalized_gains_of_the_blocks_that_are_drawn():
    random = np.random.default_rng(0)
    columns, residual = random.normal(size=(ROWS, 2)), random.normal(size=ROWS)
    blocks = np.arange(ROWS) // (ROWS // BLOCKS)
    counts = random.multinomial(BLOCKS, np.full(BLOCKS, 1.0 / BLOCKS), 5).astype(float)
    found = competitor(columns).scores(residual, blocks, counts, 3.0)
    for score, count in zip(found, counts, strict=True):
        rows = np.repeat(np.arange(ROWS), count[blocks].astype(int))
        values = np.linalg.lstsq(columns[rows], residual[rows], rcond=None)[0]
        after = residual[rows] - columns[rows] @ values
        gain = np.sum(residual[rows] ** 2) - np.sum(after**2)
        assert score == pytest.approx(gain - 3.0 * STRIBECK.parameters)
    too_small = competitor(columns, least=1e6).scores(residual, blocks, counts, 3.0)
    assert np.all(np.isneginf(too_small))


def test_an_effect_that_others_replace_in_the_bootstrap_has_them_as_rivals():
    robot = lieid.robots.two_link()
    arm = plant.demo_arm(robot, hidden=None)
    arm = arm.with_effects(plant.hidden_effect(arm, "torque_lowpass", 0, strength=0.25))
    motion = plant.FourierTrajectory(robot, base_frequency=0.1, seed=1)
    t = np.arange(0.0, 10.0, 0.002)
    train = plant.measure_along(arm, t, *motion.at(t), sensors=plant.demo_sensors(robot), seed=1)
    model = lieid.Model(robot, "coulomb,viscous,offset")
    options = replace(DiagnosisOptions(), rival_deviations=-100.0)  # no rivals by Vuong's test
    (step,) = lieid.diagnose(model, train, options=options).steps
    assert step.selected < options.least_selected  # a filter and a delay are similar
    rivals = {c.placement.label for c, _ in step.indistinguishable}
    assert "torque_delay:1" in rivals
    assert step.evidence.selected_with_rivals > step.selected
    options = replace(options, least_selected=0.0)
    (again,) = lieid.diagnose(model, train, options=options).steps
    assert (again.selected, again.indistinguishable) == (step.selected, ())
