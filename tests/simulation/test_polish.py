"""A fit refined on its simulated motion, against an arm that MuJoCo integrates."""

from dataclasses import replace

import numpy as np
import pytest
from simulation.test_simulate import fit_of, in_mujoco

import lieid_casadi as lieid
from lieid_casadi.cli.main import main
from lieid_casadi.errors import ModelError
from lieid_casadi.simulation import polish

EFFECTS = "coulomb,viscous,armature"


def wrong(fit, factor):
    """Return the fit with its effects' coefficients multiplied by factors (m,)."""
    parameters = fit.parameters.copy()
    parameters[20:] *= factor
    return replace(fit, parameters=parameters)


def test_coefficients_that_a_regression_has_missed_are_found():
    fit = fit_of(EFFECTS)
    train = in_mujoco(fit, seconds=4.0)
    bad = wrong(fit, np.array([0.85, 0.9, 1.1, 0.9, 1.15, 1.1]))
    found = polish(bad, train, window=0.5)
    truth = fit.effect_coefficients
    missed = np.abs(bad.effect_coefficients - truth) / truth
    assert (np.abs(found.fit.effect_coefficients - truth) / truth < 0.2 * missed).all()
    assert (found.after < 0.2 * found.before).all()
    np.testing.assert_array_equal(found.fit.link_parameters, bad.link_parameters)
    base = found.fit.model.base.combination @ found.fit.parameters
    np.testing.assert_allclose(found.fit.values, base)
    assert not np.allclose(found.fit.rms_train, bad.rms_train)


def test_torques_cannot_be_polished_on():
    fit = fit_of("viscous", lieid.robots.two_link())
    t = np.arange(0.0, 3.0, 0.01)
    q = np.sin(t)[:, None] * [1.0, 1.0]
    with pytest.raises(ModelError, match="commands"):
        polish(fit, lieid.Recording.from_arrays(t, q, tau=q))


def test_identify_polishes(tmp_path, capsys):
    in_mujoco(fit_of(EFFECTS), seconds=4.0).save(tmp_path / "run.csv")
    words = ["identify", "two_link", str(tmp_path / "run.csv"), "--stiffness", "60"]
    words += ["--damping", "4", "--effects", EFFECTS, "--polish"]
    assert main([*words, "-o", str(tmp_path / "fit.json")]) == 2
    assert "--method feasible" in capsys.readouterr().err
    assert main([*words, "--method", "feasible", "-o", str(tmp_path / "fit.json")]) == 0
    assert "Polished on the motion" in capsys.readouterr().out
    fit = lieid.Fit.load(tmp_path / "fit.json")
    drift = lieid.simulate(fit, in_mujoco(fit_of(EFFECTS))).drift
    assert np.degrees(drift.rms).max() < 0.2
