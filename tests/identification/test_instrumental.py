"""Noise in the motion biases least squares, not instrumental variables; the test detects it."""

import numpy as np
import pytest

import lieid_casadi as lieid
from lieid_casadi import plant
from lieid_casadi.errors import IdentificationError, ModelError
from lieid_casadi.identification.uncertainty.instrumental import instrumental
from lieid_casadi.recording import Processing

ROBOT = lieid.robots.two_link()
FRICTION = plant.JointFriction(np.array([1.2, 0.5]), np.array([0.6, 0.3]), np.array([0.2, -0.1]))
ARM = plant.Arm(ROBOT, plant.perturbed_inertias(ROBOT, seed=3), FRICTION)
MODEL = lieid.Model(ROBOT, "coulomb,viscous,offset")
# wide, so that noise reaches the columns
WIDE = Processing(cutoff=20.0)
T = np.arange(0.0, 20.0, 0.01)
MOTION = plant.FourierTrajectory(ROBOT, base_frequency=0.05, harmonics=10, seed=4).at(T)
COMMANDED = lieid.Recording.from_arrays(T, MOTION[0], MOTION[1], None, ddq=MOTION[2])


def fitted(seed, position_noise):
    sensors = plant.Sensors(
        rate=100.0, torque_noise=0.05, position_noise=position_noise, velocity="none"
    )
    recording = plant.measure_along(ARM, T, *MOTION, sensors=sensors, seed=seed)
    return lieid.identify(MODEL, recording, processing=WIDE), recording


def true_base():
    parts = {"coulomb": FRICTION.coulomb, "viscous": FRICTION.viscous, "offset": FRICTION.offset}
    effects = [parts[c.name.split(".")[0]][c.joint] for c in MODEL.columns]
    return MODEL.base.combination @ np.concatenate([ARM.parameters, effects])


@pytest.fixture(scope="module")
def noisy_runs():
    runs = [fitted(seed, 1e-3) for seed in range(12)]
    return [
        (fit, instrumental(fit, r), instrumental(fit, r, reference=COMMANDED)) for fit, r in runs
    ]


def test_instruments_remove_the_bias(noisy_runs):
    """Mean error over runs: of Izz2, whose columns are accelerations, and of all parameters."""
    truth = true_base()
    names = [p.label for p in MODEL.base_columns]
    errors = [
        np.array([r.values - truth for r in runs])
        for runs in zip(
            *((fit, own.fit, commanded.fit) for fit, own, commanded in noisy_runs), strict=True
        )
    ]
    least, own, commanded = (np.abs(e.mean(axis=0)) for e in errors)
    k = names.index("Izz2")
    assert least[k] > 0.2 * truth[k]  # columns of noise: attenuated
    assert own[k] < 0.2 * least[k]
    assert commanded[k] < 0.2 * least[k]
    relative = [np.median(np.abs(e.mean(axis=0)) / e.std(axis=0)) for e in errors]
    assert relative[0] > 2.0
    assert relative[1] < 1.0
    assert relative[2] < 1.0


def test_intervals_of_instrumental_values_cover(noisy_runs):
    truth = true_base()
    p = len(truth)
    held = [np.abs(c.fit.values - truth) < 1.96 * c.fit.std[:p] for _, _, c in noisy_runs]
    assert np.mean(held) > 0.85


def test_bias_of_least_squares_is_detected(noisy_runs):
    for fit, own, commanded in noisy_runs:
        assert own.test.biased
        assert commanded.test.biased
        assert commanded.test.noise > 0.1
        np.testing.assert_array_equal(commanded.bias, fit.values - commanded.fit.values)


def test_a_motion_without_noise_is_not_reported_as_biased():
    detected = 0
    for seed in range(12):
        fit, recording = fitted(seed, 0.0)
        result = instrumental(fit, recording, reference=COMMANDED)
        detected += result.test.biased
        np.testing.assert_array_less(np.abs(result.bias), 1.5 * fit.std)
    assert detected <= 1


def test_references_must_match():
    fit, recording = fitted(0, 0.0)
    short = COMMANDED.cut(0.0, 10.0)
    with pytest.raises(ModelError, match=r"0 to \S+ s, expected all of 0 to"):
        instrumental(fit, recording, reference=short)
    with pytest.raises(ModelError, match="2 reference motions for 1 recordings"):
        instrumental(fit, recording, reference=[COMMANDED, COMMANDED])
    feasible = lieid.identify(MODEL, recording, method="feasible", processing=WIDE)
    with pytest.raises(IdentificationError, match="expected method wls, ols or robust"):
        instrumental(feasible, recording)
