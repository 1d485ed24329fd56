"""`Fit.torque`: every effect at given samples, against `Fit.predict`."""

import numpy as np
import pytest
from exporters.c_arms import made_fit

import lieid_casadi as lieid
from lieid_casadi.errors import ModelError

PANDA = lieid.robots.panda()
EFFECTS = {
    "friction": "coulomb,viscous,stribeck:4,load_friction:2+3,temperature_friction:1,warm_up:7",
    "whole arm": "coulomb,payload,base_tilt,external_wrench",
    "measurement": "coulomb,load_friction:2,torque_gain:3,encoder_offset:2,bias_drift:5",
    "memory": "viscous,presliding:1,presliding/load:2",
}


def recording(seed=3):
    random = np.random.default_rng(seed)
    q, dq, ddq, tau = random.uniform(-1.5, 1.5, (4, 4, 7))
    temperature = random.uniform(20.0, 50.0, (4, 7))
    t = 0.01 * np.arange(4)  # too short to be filtered: predicted as it was measured
    return lieid.Recording.from_arrays(t, q, dq, tau, ddq=ddq, temperature=temperature)


@pytest.mark.parametrize("effects", EFFECTS.values(), ids=EFFECTS)
def test_it_is_the_torque_of_predict(effects):
    fit, run = made_fit(PANDA, effects), recording()
    torque = fit.torque(run.q, run.dq, run.ddq, temperature=run.temperature, time=run.t)
    expected = fit.predict(run)
    np.testing.assert_allclose(torque, expected, rtol=0, atol=1e-10 * np.abs(expected).max())


@pytest.mark.parametrize("effect", ["torque_delay:2", "joint_elasticity:2"])
def test_effects_of_the_past_are_refused(effect):
    fit, run = made_fit(PANDA, effect), recording()
    with pytest.raises(ModelError, match=f"{effect}.*before the instant"):
        fit.torque(run.q, run.dq, run.ddq)


@pytest.mark.parametrize(
    ("effect", "signal"), [("temperature_friction", "temperature"), ("warm_up", "time")]
)
def test_a_missing_signal_is_named(effect, signal):
    fit, run = made_fit(PANDA, effect), recording()
    with pytest.raises(ModelError, match=f"{effect}:1.*expected {signal}="):
        fit.torque(run.q, run.dq, run.ddq)


def test_functions_of_single_joints_refuse_effects_on_the_whole_arm():
    """They left them out silently: 2 kg at the tool changed nothing."""
    fit, run = made_fit(PANDA, "coulomb,payload"), recording()
    motion, coefficients = (run.q, run.dq, run.ddq), fit.effect_coefficients
    for call in (
        lambda: fit.compiled.effect_torque(*motion, coefficients),
        lambda: fit.compiled.effect_columns(*motion),
        lambda: fit.compiled.base_regressor(*motion),
    ):
        with pytest.raises(ModelError, match=r"payload.*Fit\.torque"):
            call()
    friction = fit.compiled.effect_torque(*motion, coefficients, joint_effects_only=True)
    coulomb = np.sign(run.dq) * coefficients[:7]
    np.testing.assert_allclose(friction, coulomb, atol=1e-12)
