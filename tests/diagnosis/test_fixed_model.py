"""How much of an error a change explains, beside a model whose parameters are uncertain."""

import numpy as np
import pytest

from lieid_casadi.diagnosis.screening.model_factor import ModelFactor
from lieid_casadi.diagnosis.search.fixed_model import relative_fall

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
