"""Temperature and warm-up, identified on the plant."""

import numpy as np
import pytest
from plant.recordings import recorded

import lieid_casadi as lieid
from lieid_casadi import plant
from lieid_casadi.errors import EffectError
from lieid_casadi.recording import Processing, process

ROBOT = lieid.robots.two_link()
FRICTION = plant.JointFriction(np.array([1.0, 0.5]), np.array([2.0, 1.0]), np.zeros(2))
OPTIONS = Processing(cutoff=8.0)


def run(effects, thermal, *, seed, temperature=True):
    arm = plant.Arm(ROBOT, plant.perturbed_inertias(ROBOT, seed=3), FRICTION, effects, thermal)
    sensors = plant.Sensors(rate=200.0, torque_noise=0.02, temperature=temperature)
    series = {"base_frequency": 0.1, "periods": 6}
    return recorded(arm, seed, seconds=60.0, step=0.005, sensors=sensors, **series)


@pytest.fixture(scope="module")
def warming():
    effects = (
        plant.TemperatureFriction(0, viscous_decay=0.03),
        plant.TemperatureFriction(1, viscous_decay=0.02),
    )
    cold = run(effects, plant.Thermal(20.0, 25.0, 30.0), seed=0)
    hot = run(effects, plant.Thermal(32.0, 12.0, 30.0), seed=1)
    return cold, hot


def error_on(recording, fit):
    """RMS per joint of filtered torque, in motion: at rest dry friction is undetermined."""
    (segment,) = process(recording, fit.processing)
    error = segment.filter(segment.tau) - fit.predict_processed(segment)
    return np.sqrt(np.mean(error**2, axis=0, where=np.abs(segment.filter(segment.dq)) > 0.03))


def test_exponential_viscous_friction_carries_over_to_another_temperature(warming):
    cold, hot = warming
    effects = "coulomb,temperature_friction/exponential"
    fit = lieid.identify(lieid.Model(ROBOT, effects), cold, processing=OPTIONS)
    plain = lieid.identify(lieid.Model(ROBOT, "coulomb,viscous"), cold, processing=OPTIONS)
    assert np.all(error_on(hot, fit) < 0.25 * error_on(hot, plain))
    assert np.all(error_on(hot, fit) < 0.03)


def test_a_recording_without_temperature_is_refused(warming):
    cold, _ = warming
    model = lieid.Model(ROBOT, "coulomb,viscous,temperature_friction")
    without = run((), plant.Thermal(), seed=2, temperature=False)
    with pytest.raises(EffectError, match="temp1"):
        lieid.identify(model, without, processing=OPTIONS)
    fit = lieid.identify(model, cold, processing=OPTIONS)
    with pytest.raises(EffectError, match="temperature_friction:1 needs temperature"):
        fit.predict(without)


def test_warm_up_finds_its_time_constant():
    effects = (plant.WarmUp(0, change=-0.4, time_constant=15.0),)
    recording = run(effects, plant.Thermal(), seed=4, temperature=False)
    fit = lieid.identify(
        lieid.Model(ROBOT, "coulomb,viscous,warm_up:1"), recording, processing=OPTIONS
    )
    assert fit.shapes[0] == pytest.approx(15.0, rel=0.1)
    rows = {r["name"] + str(r["joint"]): r["value"] for r in fit.parameter_table()}
    assert rows["warm_up.f_tv1"] == pytest.approx(-0.4 * 2.0, rel=0.1)
    assert rows["warm_up.f_tc1"] == pytest.approx(-0.4 * 1.0, rel=0.15)
