"""Parts of the formula search: dictionary, sparse regression, standard deviations."""

import numpy as np
import pytest

from lieid_casadi.diagnosis import DiagnosisOptions
from lieid_casadi.diagnosis.residual.function_dictionary import dictionaries, dictionary
from lieid_casadi.diagnosis.residual.projected_residual import ProjectedResidual
from lieid_casadi.diagnosis.residual.symbolic_formula import best_subsets
from lieid_casadi.diagnosis.screening.model_factor import ModelFactor


def test_units_of_coefficients():
    turns = (True, True, False)
    by_name = {t.text: t.unit(turns, 0) for t in dictionary(["q1", "dq2", "load1"], turns)}
    assert by_name["sin(2 q1)·dq2"] == "N·m·s/rad"
    assert by_name["dq2²"] == "N·m·s²/rad²"
    assert by_name["sgn(dq2)·|load1|"] == "1"
    powers = {t.text: t.unit(turns, 0) for t in dictionary(["q1", "dq2"], turns, waves=False)}
    assert powers["q1·dq2³"] == "N·m·s³/rad⁴"
    every = dictionary(["q1", "dq1", "ddq1", "load1", "dq2", "ddq2"], turns, waves=False)
    assert all(t.unit(turns, 0) for t in every)  # of every power
    sliding = {t.text: t.unit(turns, 2) for t in dictionary(["q3", "dq3"], turns)}
    assert sliding["dq3"] == "N·s/m"
    assert not any("sin" in text for text in sliding)


def test_waves_and_powers_of_an_angle_are_not_mixed():
    both = dictionaries(["q1", "dq1"], (True,))
    assert len(both) == 2
    for texts in ({t.text for t in terms} for terms in both):
        assert ("q1²" in texts) != ("sin(q1)" in texts)
    assert len(dictionaries(["dq1"], (True,))) == 1


@pytest.mark.parametrize("wanted", [(3,), (2, 7), (1, 5, 9)])
def test_sparse_regression_finds_the_columns(wanted):
    random = np.random.default_rng(0)
    columns = random.normal(size=(500, 12)) + 0.7 * random.normal(size=(500, 1))
    columns /= np.linalg.norm(columns, axis=0)
    truth = columns[:, list(wanted)] @ np.linspace(1.0, 2.0, len(wanted))
    found = best_subsets(columns, truth, np.ones(12), DiagnosisOptions())
    assert set(found[len(wanted) - 1]) == set(wanted)
    assert [len(each) for each in found] == [1, 2, 3]


@pytest.mark.parametrize("memory", [0.0, 0.9])
def test_standard_deviations_match_the_scatter_of_estimates(memory):
    """Of independent errors, and of errors that are correlated within blocks."""
    random, rows = np.random.default_rng(1), 2000
    model, column = np.ones((rows, 1)), np.sin(np.arange(rows) / 100.0)[:, None]
    values, stated = [], []
    for _ in range(60):
        white = random.normal(size=rows)
        error = np.zeros(rows)
        for k in range(rows):
            error[k] = (memory * error[k - 1] if k else 0.0) + white[k]
        baseline = ModelFactor.of([model], [error + 3.0 * column[:, 0] + 5.0]).baseline()
        blocks = np.arange(rows) // 40
        estimate = ProjectedResidual(
            (), (), (), baseline, blocks % 5, blocks, DiagnosisOptions()
        ).fit(column)
        values.append(estimate.values[0])
        stated.append(estimate.std[0])
    assert np.mean(values) == pytest.approx(3.0, abs=0.2)
    assert np.mean(stated) == pytest.approx(np.std(values), rel=0.35)
