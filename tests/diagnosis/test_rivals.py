"""Rivals in the final model: forms of one curve, and pairs of effects."""

from functools import cache

import numpy as np
import pytest

import lieid_casadi as lieid
from lieid_casadi import plant
from lieid_casadi.diagnosis import DiagnosisOptions
from lieid_casadi.diagnosis.screening.model_factor import ModelFactor
from lieid_casadi.diagnosis.search.rivals import rival_pairs

ROBOT = lieid.robots.two_link()
MODEL = lieid.Model(ROBOT, "coulomb,viscous,offset")
ARM = plant.demo_arm(ROBOT, hidden=None)


def lorentzian(s):
    return 0.8 * ARM.friction.coulomb[1] / (1.0 + (s.dq[..., 1] / 0.15) ** 2) * s.sign[..., 1]


@cache
def diagnosis_of(duration):
    arm = ARM.with_effects(plant.ForeignTorque(1, lorentzian))
    motion = plant.FourierTrajectory(ROBOT, base_frequency=1.0 / duration, seed=1)
    t = np.arange(0.0, duration, 0.002)
    sensors = plant.demo_sensors(ROBOT)
    return lieid.diagnose(
        MODEL, plant.measure_along(arm, t, *motion.at(t), sensors=sensors, seed=1)
    )


@pytest.mark.parametrize("duration", [20.0, 40.0])
def test_a_lorentzian_stribeck_curve_is_named_by_its_class(duration):
    """No effect of the library has this form."""
    diagnosis = diagnosis_of(duration)
    assert {step.joints for step in diagnosis.steps} == {(1,)}
    named = {step.effect for step in diagnosis.steps}
    rivals = {c.name for step in diagnosis.steps for c, _ in step.indistinguishable}
    assert named | rivals >= {"stribeck", "viscous_polynomial"}
    assert diagnosis.sentence.startswith("Friction on joint 2 falls with speed (")
    assert "the form of the curve is not identified" in diagnosis.sentence


def test_json_lists_pairs_of_rivals():
    for step in diagnosis_of(20.0).to_dict()["steps"]:
        assert isinstance(step["rival_pairs"], list)


class Columns:
    """Four single columns on the rows of one joint."""

    def __init__(self, matrix):
        self.matrix = matrix

    def stacked(self, group):
        return self.matrix[:, [group]]

    def owner(self, group):
        return self

    parameters = 1


def test_a_pair_that_explains_more_than_an_effect_is_its_rival():
    random = np.random.default_rng(3)
    matrix = random.normal(size=(400, 4))
    torque = 0.5 * (matrix[:, 0] + matrix[:, 1]) + random.normal(size=400)
    resembling = (matrix[:, :1] + matrix[:, 1:2]) + 0.3 * random.normal(size=(400, 1))
    baseline = ModelFactor.of([np.ones((400, 1))], [torque]).baseline()
    found = rival_pairs(
        Columns(matrix), baseline, resembling, parameters=1, tried=[0, 1, 2, 3],
        blocks=np.arange(400) // 10, options=DiagnosisOptions(rival_deviations=1e9),
    )  # fmt: skip
    assert [pair.groups for pair in found] == [(0, 1)]
