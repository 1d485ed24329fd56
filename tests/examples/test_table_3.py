"""Columns of unit norm in the paper's condition number (Table III)."""

import importlib.util
from pathlib import Path

import numpy as np
import pytest

from lieid_casadi.excitation.criteria import Condition, LogDet

PATH = Path(__file__).parents[2] / "examples" / "table_3.py"


@pytest.mark.parametrize("inner", [Condition(np.eye(5), 4.0), LogDet()])
def test_the_scaled_criterion_and_its_derivative(inner):
    """No dependence on units; the derivative by differences."""
    specification = importlib.util.spec_from_file_location("table_3", PATH)
    script = importlib.util.module_from_spec(specification)
    specification.loader.exec_module(script)
    criterion = script.UnitNormColumns(inner)
    random = np.random.default_rng(0)
    rows, change = random.normal(size=(12, 5)), random.normal(size=(5, 5))
    gram, change = rows.T @ rows, 1e-6 * (change + change.T)
    value, slope = criterion.evaluate(gram)
    units = np.diag(np.arange(1.0, 6.0))
    assert np.isclose(value, criterion.evaluate(units @ gram @ units)[0])
    difference = criterion.evaluate(gram + change)[0] - criterion.evaluate(gram - change)[0]
    assert np.isclose(2.0 * np.sum(slope * change), difference, rtol=1e-5)
