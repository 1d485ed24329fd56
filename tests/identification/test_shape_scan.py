"""Shape parameters follow from the data: not from the order of the effects, nor from a start."""

from dataclasses import replace

import numpy as np
import pytest

import lieid_casadi as lieid
from lieid_casadi import plant
from lieid_casadi.recording import Processing

ROBOT = lieid.robots.two_link()
OPTIONS = Processing(cutoff=8.0)


def recorded(hidden, seed=0, noise=0.02):
    """An arm with friction, whose joint 2 has a further torque; 100 Hz, 16 s."""
    friction = plant.JointFriction(np.array([1.2, 0.5]), np.array([0.6, 0.3]), np.zeros(2))
    arm = plant.Arm(ROBOT, ROBOT.link_parameters, friction)
    motion = plant.FourierTrajectory(ROBOT, base_frequency=1 / 16, seed=seed)
    t = np.arange(0.0, 16.0, 0.01)
    sensors = plant.Sensors(rate=100.0, torque_noise=noise)
    run = plant.measure_along(arm, t, *motion.at(t), sensors=sensors, seed=seed)
    tau = run.tau.copy()
    tau[:, 1] += hidden(run.q[:, 1], run.dq[:, 1])
    return replace(run, tau=tau)


def ripple(q, dq):
    """A strong ripple of low order and a weak one of high order, as of a harmonic drive."""
    slow = np.exp(-((dq / 0.3) ** 2))
    return 0.2 * np.sin(2.3 * q) + slow * 0.2 * np.sin(202.0 * q) + 0.3 * np.sign(dq) * slow


MODELS = {
    "ripple": "coulomb,viscous,offset,torque_ripple:2,stribeck:2",
    "hysteresis": "viscous,offset,presliding:1+2,stribeck:2,position_friction:2",
    "load": "coulomb,viscous,load_friction/stribeck:2,torque_ripple:2,stribeck:1+2",
}
CASES = ["ripple", *(pytest.param(x, marks=pytest.mark.slow) for x in ("hysteresis", "load"))]


@pytest.mark.parametrize("name", CASES)
def test_order_does_not_change_the_fit(name):
    run = recorded(ripple)
    effects = [
        p.label for p in lieid.Model(ROBOT, MODELS[name]).placements
    ]  # one by one, so that any order is possible
    first = lieid.identify(lieid.Model(ROBOT, effects), run, processing=OPTIONS)
    found = dict(zip([s.label for s in first.model.shapes], first.shapes, strict=True))
    for order in (effects[::-1], effects[2:] + effects[:2]):
        model = lieid.Model(ROBOT, order)
        fit = lieid.identify(model, run, processing=OPTIONS)
        expected = [found[s.label] for s in model.shapes]
        np.testing.assert_allclose(fit.shapes, expected, rtol=1e-3)
        np.testing.assert_allclose(fit.rms_train, first.rms_train, rtol=1e-6)


def test_the_order_of_a_ripple_is_found_among_all():
    """Between 1.9 and 400, beside effects whose shapes are searched as well."""

    def hidden(q, dq):
        return 0.3 * np.exp(-((dq / 0.2) ** 2)) * np.sign(dq) + 0.15 * np.cos(202.0 * q + 0.5)

    run = recorded(hidden)
    model = lieid.Model(ROBOT, "coulomb,viscous,offset,stribeck:1+2,torque_ripple:1+2")
    fit = lieid.identify(model, run, processing=OPTIONS)
    found = dict(zip([s.label for s in model.shapes], fit.shapes, strict=True))
    assert found["torque_ripple.k:2"] == pytest.approx(202.0, abs=0.1)
    assert found["stribeck.v_s:2"] == pytest.approx(0.2, rel=0.2)


@pytest.mark.parametrize("name", CASES)
def test_no_value_of_a_shape_lowers_the_error(name):
    """Each shape in turn over a grid of this test, the others and their load held."""
    run = recorded(ripple)
    model = lieid.Model(ROBOT, MODELS[name])
    fit = lieid.identify(model, run, processing=OPTIONS)
    cost = np.sum(np.log(fit.noise))
    for k, shape in enumerate(model.shapes):
        for place in (0.05, 0.5, 0.95):
            values = fit.shapes.copy()
            low = max(shape.lower, 1e-9)
            values[k] = low * (shape.upper / low) ** place
            held = lieid.identify(model, run, processing=OPTIONS, held_shapes=values)
            assert np.sum(np.log(held.noise)) > cost - 1e-3
