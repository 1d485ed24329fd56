"""Samples of a fit and its rivals: consistent, reproducible, weighted, covering, as files."""

import json
from dataclasses import replace

import numpy as np
import pytest
from plant.recordings import recorded as measured

import lieid_casadi as lieid
from lieid_casadi import plant
from lieid_casadi.cli.main import main
from lieid_casadi.errors import IdentificationError
from lieid_casadi.identification.ensemble import ensemble_coverage, model_weights
from lieid_casadi.recording import Processing


def recorded(seed, *hidden, duration=20.0, noise=0.05, inertias=3):
    robot = lieid.robots.two_link()
    friction = plant.JointFriction(np.array([1.2, 0.5]), np.array([0.6, 0.3]), np.array([0.2, 0.1]))
    arm = plant.Arm(robot, plant.perturbed_inertias(robot, seed=inertias), friction, hidden)
    sensors = plant.Sensors(rate=100.0, torque_noise=noise)
    return measured(arm, seed, seconds=duration, step=0.01, sensors=sensors, base_frequency=0.1)


def fitted(seed=1, method="feasible", **options):
    model = lieid.Model(lieid.robots.two_link(), "coulomb,viscous,offset")
    return lieid.identify(
        model, recorded(seed, **options), method=method, processing=Processing(cutoff=5.0)
    )


@pytest.fixture(scope="module")
def fit():
    return fitted()


def test_samples_are_consistent_and_reproducible(fit):
    samples = fit.sample(30, seed=4)
    assert len(samples) == 30
    assert all(s.physically_consistent and s.certificate.holds for s in samples)
    coulomb = np.array([c.name == "coulomb.f_c" for c in fit.model.columns])
    assert all((s.effect_coefficients[coulomb] >= 0.0).all() for s in samples)
    for s in samples:
        np.testing.assert_allclose(s.model.base.combination @ s.parameters, s.values, atol=1e-12)
    again = fit.sample(30, seed=4)
    np.testing.assert_array_equal(samples[7].parameters, again[7].parameters)
    assert not np.array_equal(samples[0].parameters, fit.sample(1, seed=5)[0].parameters)


def test_draws_have_the_covariance_where_constraints_do_not_act(fit):
    """With a hundredth of the standard deviations no draw leaves the consistent parameters."""
    narrow = replace(fit, covariance=1e-4 * fit.covariance)
    values = np.array([s.values for s in narrow.sample(300, seed=1)])
    np.testing.assert_allclose(values.std(axis=0), 0.01 * fit.std, rtol=0.2)
    np.testing.assert_allclose(values.mean(axis=0), fit.values, atol=0.01 * 5 * fit.std.max() / 17)


@pytest.mark.slow
def test_ensembles_cover_the_true_torque():
    """90 % ensembles over 20 arms; within one arm the coverage is all or nothing."""
    inside = []
    for seed in range(20):
        fit = fitted(100 + seed, inertias=seed)
        test = recorded(200 + seed, duration=10.0, noise=0.0, inertias=seed)
        torque = np.array([s.predict(test) for s in fit.sample(40, seed=seed)])
        low, high = np.percentile(torque, [5.0, 95.0], axis=0)
        moving = np.abs(test.dq) > 0.05
        inside.append(np.mean(((test.tau >= low) & (test.tau <= high))[moving]))
    assert 0.8 < np.mean(inside) < 0.97


def test_inconsistent_fits_are_refused(fit):
    with pytest.raises(IdentificationError, match="method feasible"):
        replace(fit, parameters=-fit.parameters).sample(1)
    with pytest.raises(IdentificationError, match="at least 1"):
        fit.sample(0)


def test_command_writes_arrays_and_models(fit, tmp_path, capsys):
    import mujoco

    fit.save(tmp_path / "fit.json")
    words = ["sample", str(tmp_path / "fit.json"), "-n", "3", "--seed", "7"]
    assert main([*words, "-o", str(tmp_path / "out"), "--to", "mjcf"]) == 0
    assert "3 samples" in capsys.readouterr().out
    arrays = np.load(tmp_path / "out" / "samples.npz")
    expected = lieid.Fit.load(tmp_path / "fit.json").sample(3, seed=7)
    np.testing.assert_array_equal(arrays["link_parameters"][1], expected[1].link_parameters)
    assert list(arrays["effect_coefficients_names"]) == [c.label for c in fit.model.columns]
    model = mujoco.MjModel.from_xml_path(str(tmp_path / "out" / "sample_002.xml"))
    assert model.body_mass[1] == pytest.approx(expected[1].link_parameters[0], rel=1e-9)


ROBOT = lieid.robots.two_link()
PLAIN = "coulomb,viscous,offset"


def stribeck_run(seed, *, extra=0.6, duration=20.0):
    hidden = plant.Stribeck(0, extra=extra, velocity=0.3)
    return recorded(seed, hidden, duration=duration, noise=0.1)


@pytest.fixture(scope="module")
def fits():
    """The model of the arm, one without its effect, and one with another effect."""
    options = {"method": "feasible", "processing": lieid.Processing(cutoff=5.0)}
    models = [f"{PLAIN},stribeck:1", PLAIN, f"{PLAIN},viscous_asymmetric:1"]
    return [lieid.identify(lieid.Model(ROBOT, x), stribeck_run(1), **options) for x in models]


@pytest.fixture(scope="module")
def unseen():
    return stribeck_run(9)


def test_the_model_of_the_arm_has_the_weight(fits, unseen):
    weights = model_weights(fits, unseen)
    assert weights.sum() == pytest.approx(1.0)
    assert weights[0] > 0.99
    backwards = model_weights(fits[::-1], unseen)
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
    tests = [stribeck_run(seed) for seed in (9, 10, 11)]
    found = ensemble_coverage(fits[0].sample(40, seed=1), tests)
    np.testing.assert_allclose(found.share, 0.9, atol=0.05)
    assert not found.too_narrow.any()
    assert np.all(found.spread < found.error)


def test_errors_of_the_model_are_reported(fits):
    """The hidden effect is four times that of the training."""
    found = ensemble_coverage(fits[1].sample(20, seed=1), stribeck_run(9, extra=2.4))
    assert found.too_narrow.tolist() == [True, False]
    assert "On joint 1 errors of the model dominate" in found.sentence


def test_short_recordings_give_no_weights(fits):
    with pytest.raises(IdentificationError, match="expected at least 5 to weight models"):
        model_weights(fits, stribeck_run(9, duration=6.0))


def test_command_samples_rivals_and_states_the_coverage(fits, unseen, tmp_path, capsys):
    for k, fit in enumerate(fits):
        fit.save(tmp_path / f"{k}.json")
    unseen.save(tmp_path / "test.csv")
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
