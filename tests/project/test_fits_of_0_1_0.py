"""Fit files that version 0.1.0 wrote are read, and predict what they predicted there.

The files in ``data/fits_0_1_0`` were written by version 0.1.0 (commit 787729c): fits of a simulated
two-link arm, a motion of four seconds, and the torque (N·m) that 0.1.0 predicted along it.
"""

from pathlib import Path

import numpy as np
import pytest

import lieid_casadi as lieid

FOLDER = Path(__file__).parent / "data" / "fits_0_1_0"
EFFECTS = {
    "joints": "coulomb,viscous,offset,stribeck:1,load_friction:2,presliding:2",
    "arm": "coulomb,viscous,offset,base_tilt,armature:2,torque_delay:2",
    "feasible": "coulomb,viscous,offset,viscous_polynomial:1",
}


@pytest.fixture(scope="module")
def motion():
    return lieid.Recording.load(FOLDER / "motion.csv")


@pytest.mark.parametrize("name", EFFECTS)
def test_fit_of_0_1_0_predicts_identically(motion, name):
    fit = lieid.Fit.load(FOLDER / f"fit_{name}.json")
    assert ",".join(fit.model.effects) == EFFECTS[name]
    expected = np.loadtxt(FOLDER / f"predicted_{name}.csv", delimiter=",", skiprows=1)
    np.testing.assert_allclose(fit.predict(motion), expected, rtol=1e-9, atol=1e-9)
