"""Torque that is a function of the load, which the parameters of the links determine."""

from dataclasses import replace

import numpy as np
import pytest
from plant.recordings import recorded

import lieid_casadi as lieid
from lieid_casadi import plant
from lieid_casadi.diagnosis.final_model import FinalModel
from lieid_casadi.errors import ConvergenceWarning
from lieid_casadi.recording import Processing, process

ROBOT = lieid.robots.two_link()
PLAIN = "coulomb,viscous,offset"
NOISE, RATE, CUTOFF = 0.02, 100.0, 8.0
OPTIONS = Processing(cutoff=CUTOFF)


@pytest.fixture(scope="module")
def motion():
    """An arm without friction, whose torque is its load."""
    none = plant.JointFriction(np.zeros(2), np.zeros(2), np.zeros(2))
    arm = plant.Arm(ROBOT, ROBOT.link_parameters, none)
    sensors = plant.Sensors(rate=RATE)
    return recorded(arm, 0, seconds=16.0, step=1.0 / RATE, sensors=sensors)


def with_torque(motion, function, seed=0):
    """The recording with a further torque on joint 1, in units of its load's deviation."""
    load = motion.tau[:, 0]
    tau = motion.tau + NOISE * np.random.default_rng(seed).normal(size=motion.tau.shape)
    tau[:, 0] += load.std() * function(load / load.std())
    return replace(motion, tau=tau)


def wave(load):
    return 0.2 * np.sin(6.0 * load)


def step(load):
    return np.tanh(10.0 * load)


def fitted(recording, effects):
    return lieid.identify(lieid.Model(ROBOT, effects), recording, processing=OPTIONS)


def test_a_wave_along_the_load_is_fitted_to_the_noise(motion):
    """Linear fits at the last load, repeated, settle at thirty times the noise."""
    fit = fitted(with_torque(motion, wave), f"{PLAIN},smooth/load:1")
    passed = NOISE * np.sqrt(2.0 * CUTOFF / RATE)
    assert fit.rms_train[0] < 2.0 * passed
    assert fit.rms_cv[0] < 3.0 * passed


def test_a_step_at_the_load_s_zero_does_not_make_the_fit_oscillate(motion):
    recording = with_torque(motion, step)
    before, fit = (fitted(recording, e) for e in (PLAIN, f"{PLAIN},smooth/q.load:1"))
    assert fit.rms_train[0] < 0.1 * before.rms_train[0]
    assert not [w for w in fit.warnings if isinstance(w, ConvergenceWarning)]


def test_standard_deviations_of_links_beside_a_function_of_their_load(motion):
    """They are the scatter of thirty fits to new noise."""
    fits = [fitted(with_torque(motion, wave, seed), f"{PLAIN},smooth/load:1") for seed in range(30)]
    links = [k for k, p in enumerate(fits[0].model.base_columns) if "." not in p.name]
    assert len(links) == 6
    scatter = np.std([fit.values for fit in fits], axis=0)[links]
    stated = np.median([fit.std[: len(fit.values)] for fit in fits], axis=0)[links]
    np.testing.assert_array_less(scatter / stated, 1.7)
    np.testing.assert_array_less(0.5, scatter / stated)


def test_the_final_model_without_a_function_of_the_load_is_that_of_a_new_fit(motion):
    recording = with_torque(motion, step)
    fit = fitted(recording, f"{PLAIN},smooth/load:1")
    final = FinalModel.of(fit, process([recording], fit.processing))
    none = np.zeros(0, dtype=np.intp)
    np.testing.assert_allclose(final.cross_validated(none), fit.rms_cv, rtol=1e-5)
    own = final.columns_of([fit.model.placements[-1]])
    again = fitted(recording, PLAIN)
    np.testing.assert_allclose(final.without(own).rms_train, again.rms_train, rtol=0.05)
    np.testing.assert_allclose(final.cross_validated(own), again.rms_cv, rtol=0.05)
