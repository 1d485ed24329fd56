"""The torque of a change is the difference of two models: with the change, and without."""

import numpy as np
import pytest
from comparison.two_link_data import motion, torque

import lieid_casadi as lieid
from lieid_casadi.diagnosis import change_torque
from lieid_casadi.identification.prediction import torque_along
from lieid_casadi.recording import process
from lieid_casadi.robot.inertia import parameter_transport


@pytest.fixture(scope="module")
def kept():
    """Return a fit and a segment of another recording."""
    robot = lieid.robots.two_link()
    model = lieid.Model(robot, "coulomb,viscous,offset,load_friction:1")
    recordings = []
    for seed in (3, 8):
        t, q, dq, ddq = motion(12.0, seed=seed)
        recordings.append(lieid.Recording.from_arrays(t, q, dq, torque(q, dq, ddq), ddq=ddq))
    fit = lieid.identify(model, recordings[0])
    return fit, process(recordings[1], fit.processing)[0]


def difference(fit, segment, label, values, shapes=()):
    """Return the torque of the model with an effect minus that of the fit."""
    model = fit.model.with_effect(label)
    parameters = np.concatenate([fit.parameters, values])
    with_effect = torque_along(
        lieid.compile(model), segment, parameters, np.concatenate([fit.shapes, shapes])
    )
    return with_effect - torque_along(fit.compiled, segment, fit.parameters, fit.shapes)


@pytest.mark.parametrize(
    ("label", "shapes"),
    [
        ("load_friction:2", ()),
        ("stribeck:1", (0.1,)),
        ("transmission_coupling:1<2", ()),
        ("base_tilt", ()),
    ],
)
def test_a_new_effect(kept, label, shapes):
    fit, segment = kept
    effect = fit.model.with_effect(label).placements[-1].effect
    values = np.linspace(0.1, 0.2, len(effect.coefficients))
    named = {c.name: v for c, v in zip(effect.coefficients, values, strict=True)}
    named |= {s.name: v for s, v in zip(effect.shapes, shapes, strict=True)}
    found = change_torque(fit, segment, label, named)
    expected = difference(fit, segment, label, values, shapes)
    assert np.abs(expected).max() > 1e-3
    np.testing.assert_allclose(found, expected, atol=1e-9)


def test_an_effect_of_the_model(kept):
    fit, segment = kept
    found = change_torque(fit, segment, "viscous:2", {"f_v": 0.3})
    np.testing.assert_allclose(found, [0.0, 0.3] * segment.dq, atol=1e-12)


def test_a_payload_changes_the_load_friction(kept):
    fit, segment = kept
    found = change_torque(fit, segment, "payload", {"m": 0.5, "mcx": 0.05, "mcy": 0.0, "mcz": 0.0})
    point = np.array([0.5, 0.05, 0.0, 0.0, 0.0, 0.0, 0.005, 0.0, 0.0, 0.005])  # 0.1 m from the tool
    changed = fit.parameters.copy()
    changed[10:20] += parameter_transport(fit.model.robot.tool) @ point
    expected = torque_along(fit.compiled, segment, changed, fit.shapes)
    expected -= torque_along(fit.compiled, segment, fit.parameters, fit.shapes)
    np.testing.assert_allclose(found, expected, atol=2e-3 * np.abs(expected).max())
