"""Samples of a fit: consistent, reproducible, with the fit's covariance, as files."""

from dataclasses import replace

import numpy as np
import pytest

import lieid_casadi as lieid
from lieid_casadi import plant
from lieid_casadi.cli.main import main
from lieid_casadi.errors import IdentificationError
from lieid_casadi.recording import Processing


def recorded(seed, duration=20.0, noise=0.05, inertias=3):
    robot = lieid.robots.two_link()
    friction = plant.JointFriction(np.array([1.2, 0.5]), np.array([0.6, 0.3]), np.array([0.2, 0.1]))
    arm = plant.Arm(robot, plant.perturbed_inertias(robot, seed=inertias), friction)
    motion = plant.FourierTrajectory(robot, base_frequency=0.1, seed=seed)
    t = np.arange(0.0, duration, 0.01)
    sensors = plant.Sensors(rate=100.0, torque_noise=noise)
    return plant.measure_along(arm, t, *motion.at(t), sensors=sensors, seed=seed)


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


def test_command_writes_arrays_and_models(fit, tmp_path, capsys, refusal):
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
    refusal([*words[:3], "0", "-o", tmp_path / "none"], "expected a whole number, 1 or more")
