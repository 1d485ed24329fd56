"""How much of an error a change explains, beside a model whose parameters are uncertain."""

import numpy as np
import pytest

from lieid_casadi.diagnosis.screening.held_out import HeldOut
from lieid_casadi.diagnosis.screening.held_out_parts import Parts
from lieid_casadi.diagnosis.screening.model_factor import ModelFactor
from lieid_casadi.diagnosis.search.fixed_model import relative_fall, unconfirmed

ROWS = 4000
MODEL, OTHER, NOISE = np.random.default_rng(0).normal(size=(3, ROWS, 1))


@pytest.mark.parametrize(
    ("column", "shift"),
    [
        (OTHER, 10.0),  # an error of the model's parameter, larger than the change
        (0.9 * MODEL + np.sqrt(0.19) * OTHER, 0.0),  # a change that the parameter could imitate
    ],
)
def test_the_fall_is_that_of_the_torque_of_the_change(column, shift):
    prior = np.full((1, 1), 0.01)  # the parameter is uncertain by 100
    torque = (shift * MODEL + column + NOISE)[:, 0]
    baseline = ModelFactor.of([MODEL, prior], [torque, np.zeros(1)]).baseline()
    (fall,) = relative_fall(baseline, column, 1)
    assert fall == pytest.approx(1.0 - 1.0 / np.sqrt(2.0), abs=0.03)


@pytest.mark.parametrize(
    ("gain", "recordings", "alone", "reason"),
    [
        ((5.0, -16.0, 180.0, -5.0, 7.0), False, True, "falls on part 3 alone"),
        ((5.0, -6.0, 180.0, -5.0, 7.0), False, True, ""),
        ((180.0, -5.0), True, True, ""),  # only one of two recordings excites the change
        ((5.0, -16.0, 8.0, -5.0, 7.0), False, True, "does not fall"),
        ((5.0, 16.0, 8.0, 5.0, 7.0), False, True, ""),
        ((5.0, 16.0, 8.0, 5.0, 7.0), False, False, "is within the noise"),
    ],
)
def test_a_change_is_confirmed_by_more_than_one_block_of_time(gain, recordings, alone, reason):
    names = tuple(f"part {k + 1}" for k in range(len(gain)))
    parts = Parts(names, np.zeros(0, np.intp), np.zeros((len(gain), 0), bool), recordings)
    errors, judged = np.zeros(1), np.array(gain) > 50.0
    found = unconfirmed(HeldOut(parts, np.array(gain), judged, errors, errors), alone=alone)
    assert found.endswith(reason)
    assert bool(found) == bool(reason)
