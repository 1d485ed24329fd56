"""Effects computed along a whole segment, compared with the simulated arm."""

import numpy as np
import pytest
from plant.recordings import recorded

import lieid_casadi as lieid
from lieid_casadi import plant
from lieid_casadi.identification.prediction import torque_along
from lieid_casadi.identification.regression.segment_columns import effects_along
from lieid_casadi.recording import Processing, process

ROBOT = lieid.robots.panda()
LINKS = ROBOT.link_parameters
NONE = plant.JointFriction.none(7)
# hidden effect, the model's name for it, its coefficients
CASES = {
    "gain": (plant.TorqueGain(2, 0.1), "torque_gain:3", [0.1]),
    "delay": (plant.TorqueDelay(1, 0.03), "torque_delay:2", [0.03]),
    "shift": (plant.TimeShift(0.03), "time_shift", [0.03]),
    "filter": (plant.TorqueLowpass(1, 0.03), "torque_lowpass:2", [0.03]),
    "filter of all": (
        plant.TorqueLowpass(None, 0.02, 2),
        "torque_lowpass/common_second_order",
        [0.02],
    ),
    "offset": (plant.EncoderOffset(3, 0.05), "encoder_offset:4", [0.05]),
    "tilt": (plant.BaseTilt(0.06, -0.04), "base_tilt", [0.06, -0.04]),
    "wrench": (
        plant.ExternalWrench((1.0, -2.0, 0.5), (10.0, 5.0, -8.0)),
        "external_wrench",
        [1.0, -2.0, 0.5, 10.0, 5.0, -8.0],
    ),
    "payload": (
        plant.Payload(1.5, (0.02, -0.01, 0.04), 1e-6),
        "payload",
        [1.5, 0.03, -0.015, 0.06],
    ),
    "elasticity": (plant.JointElasticity(1, 5e3), "joint_elasticity:2", [2e-4]),
}


def measured(effect):
    arm = plant.Arm(ROBOT, LINKS, NONE, (effect,))
    return recorded(arm, 4, seconds=8.0, step=0.001, sensors=plant.Sensors(rate=None))


@pytest.mark.parametrize("name", CASES)
def test_the_predicted_torque_matches_the_simulated_arm(name):
    effect, label, coefficients = CASES[name]
    recording = measured(effect)
    model = lieid.Model(ROBOT, label)
    (segment,) = process(recording, Processing(cutoff=20.0))
    parameters = np.concatenate([LINKS, coefficients])
    error = segment.filter(
        segment.tau - torque_along(lieid.compile(model), segment, parameters, np.zeros(0))
    )
    without = segment.filter(
        segment.tau - torque_along(lieid.compile(lieid.Model(ROBOT)), segment, LINKS, np.zeros(0))
    )
    # the body's own inertia about the tool, and the neglected higher derivatives, are small
    share = 0.03 if name in ("payload", "elasticity") else 0.01
    assert np.sqrt(np.mean(error**2)) < share * np.sqrt(np.mean(without**2))


@pytest.mark.parametrize(
    "name", ["gain", "delay", "shift", "filter", "filter of all", "offset", "tilt", "elasticity"]
)
def test_the_fit_finds_the_value(name):
    effect, label, coefficients = CASES[name]
    fit = lieid.identify(
        lieid.Model(ROBOT, label), measured(effect), processing=Processing(cutoff=20.0)
    )
    first = label.partition(":")[0]
    found = [r["value"] for r in fit.parameter_table() if r["name"].startswith(first)]
    np.testing.assert_allclose(found, coefficients, rtol=0.05)


def test_drift_of_one_recording_is_not_predicted_for_another():
    recording = measured(plant.BiasDrift(0, 0.5))
    fit = lieid.identify(
        lieid.Model(ROBOT, "bias_drift:1"), recording, processing=Processing(cutoff=20.0)
    )
    (row,) = [r for r in fit.parameter_table() if r["name"].startswith("bias_drift")]
    assert row["value"] == pytest.approx(0.5, rel=0.02)
    (segment,) = process(recording, fit.processing)
    arm = lieid.compile(fit.model)
    here = effects_along(arm, segment, fit.shapes, fit.parameters, fitted=True)
    elsewhere = effects_along(arm, segment, fit.shapes, fit.parameters, fitted=False)
    assert np.ptp(here[:, 0, -1]) > 5.0
    assert not elsewhere.any()


def test_an_effect_on_the_whole_arm_has_no_joint():
    model = lieid.Model(ROBOT, "coulomb,base_tilt")
    assert model.effects == ["coulomb", "base_tilt"]
    with pytest.raises(lieid.LieidError, match="whole arm"):
        lieid.Model(ROBOT, "base_tilt:2")
