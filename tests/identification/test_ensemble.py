"""Samples of a fit and its rivals: weights by held-out errors, and what the samples cover."""

import json

import numpy as np
import pytest

import lieid_casadi as lieid
from lieid_casadi import plant
from lieid_casadi.cli.main import main
from lieid_casadi.errors import IdentificationError
from lieid_casadi.identification.ensemble import ensemble_coverage, model_weights

ROBOT = lieid.robots.two_link()
PLAIN = "coulomb,viscous,offset"


def recorded(seed, *, extra=0.6, duration=20.0):
    friction = plant.JointFriction(np.array([1.2, 0.5]), np.array([0.6, 0.3]), np.array([0.2, 0.1]))
    hidden = (plant.Stribeck(0, extra=extra, velocity=0.3),)
    arm = plant.Arm(ROBOT, plant.perturbed_inertias(ROBOT, seed=3), friction, hidden)
    motion = plant.FourierTrajectory(ROBOT, base_frequency=0.1, seed=seed)
    t = np.arange(0.0, duration, 0.01)
    sensors = plant.Sensors(rate=100.0, torque_noise=0.1)
    return plant.measure_along(arm, t, *motion.at(t), sensors=sensors, seed=seed)


@pytest.fixture(scope="module")
def fits():
    """The model of the arm, one without its effect, and one with another effect."""
    options = {"method": "feasible", "processing": lieid.Processing(cutoff=5.0)}
    models = [f"{PLAIN},stribeck:1", PLAIN, f"{PLAIN},viscous_asymmetric:1"]
    return [lieid.identify(lieid.Model(ROBOT, x), recorded(1), **options) for x in models]


@pytest.fixture(scope="module")
def test():
    return recorded(9)


def test_the_model_of_the_arm_has_the_weight(fits, test):
    weights = model_weights(fits, test)
    assert weights.sum() == pytest.approx(1.0)
    assert weights[0] > 0.99
    backwards = model_weights(fits[::-1], test)
    np.testing.assert_allclose(backwards[::-1], weights, atol=1e-9)


def test_samples_of_rivals_are_in_proportion_to_their_weights(fits):
    samples = fits[0].sample(60, seed=3, rivals=fits[1:], weights=[3, 0, 1])
    names = [",".join(s.model.effects) for s in samples]
    assert set(names) == {",".join(fits[k].model.effects) for k in (0, 2)}
    assert 35 <= names.count(names[0]) <= 55 or 5 <= names.count(names[0]) <= 25
    assert all(s.physically_consistent for s in samples)
    again = fits[0].sample(60, seed=3, rivals=fits[1:], weights=[3, 0, 1])
    assert all(a.parameters is not b.parameters for a, b in zip(samples, again, strict=True))
    assert [a.parameters.tolist() for a in samples] == [b.parameters.tolist() for b in again]


@pytest.mark.parametrize("weights", [[1.0], [1.0, -1.0], [0.0, 0.0], [np.nan, 1.0]])
def test_weights_that_do_not_match_are_refused(fits, weights):
    with pytest.raises(IdentificationError, match="expected 2 numbers from 0"):
        fits[0].sample(2, rivals=fits[1:2], weights=weights)


def test_coverage_of_a_complete_model_is_its_level(fits):
    tests = [recorded(seed) for seed in (9, 10, 11)]
    found = ensemble_coverage(fits[0].sample(40, seed=1), tests)
    np.testing.assert_allclose(found.share, 0.9, atol=0.05)
    assert not found.too_narrow.any()
    assert np.all(found.spread < found.error)


def test_errors_of_the_model_are_reported(fits):
    """The hidden effect is four times that of the training."""
    found = ensemble_coverage(fits[1].sample(20, seed=1), recorded(9, extra=2.4))
    assert found.too_narrow.tolist() == [True, False]
    assert "On joint 1 errors of the model dominate" in found.sentence


def test_short_recordings_give_no_weights(fits):
    with pytest.raises(IdentificationError, match="expected at least 5 to weight models"):
        model_weights(fits, recorded(9, duration=6.0))


def test_command_samples_rivals_and_states_the_coverage(fits, test, tmp_path, capsys):
    for k, fit in enumerate(fits):
        fit.save(tmp_path / f"{k}.json")
    test.save(tmp_path / "test.csv")
    paths = [str(tmp_path / f"{k}.json") for k in range(3)]
    words = ["sample", paths[0], "-n", "8", "--rival", paths[1], "--rival", paths[2]]
    words += ["--test", str(tmp_path / "test.csv"), "--json", str(tmp_path / "s.json")]
    assert main([*words, "-o", str(tmp_path / "out")]) == 0
    shown = capsys.readouterr().out
    assert "90 % bands of the samples" in shown
    content = json.loads((tmp_path / "s.json").read_text())
    assert content["weights"][0] > 0.99
    assert len(content["coverage"]["share"]) == 2
    assert main([*words, "--weights", "1", "1", "1", "-o", str(tmp_path / "even")]) == 0
    arrays = np.load(tmp_path / "even" / "samples.npz")
    assert len(arrays["models"]) >= 2
    column = list(arrays["effect_coefficients_names"]).index("stribeck.f_s-f_c:1")
    own = arrays["models"][arrays["model"]] == ",".join(fits[0].model.effects)
    assert np.all(arrays["effect_coefficients"][~own, column] == 0.0)
    assert np.all(arrays["effect_coefficients"][own, column] > 0.0)
