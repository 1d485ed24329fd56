"""A measured velocity with more noise than the encoder must not bias inertias."""

import numpy as np

import lieid_casadi as lieid
from lieid_casadi import plant
from lieid_casadi.recording import Processing
from lieid_casadi.recording import motion as choice

COUNTS, VELOCITY_NOISE = 2**18, 0.028  # per turn; rad/s
ROBOT = lieid.robots.two_link()
EFFECTS = "coulomb,viscous,offset"


def errors():
    """Errors of the base parameters (p,), in standard deviations and in SI units."""
    friction = plant.JointFriction(np.array([1.0, 0.4]), np.array([0.6, 0.2]), np.zeros(2))
    links = plant.perturbed_inertias(ROBOT, seed=3)
    arm = plant.Arm(ROBOT, links, friction, ())
    t = np.arange(0.0, 40.0, 0.005)
    motion = plant.FourierTrajectory(ROBOT, base_frequency=0.1, periods=4, seed=1)
    sensors = plant.Sensors(
        rate=200.0, torque_noise=0.02, counts_per_turn=COUNTS, velocity_noise=VELOCITY_NOISE
    )
    recording = plant.measure_along(arm, t, *motion.at(t), sensors=sensors, seed=0)
    model = lieid.Model(ROBOT, EFFECTS)
    fit = lieid.identify(model, recording, processing=Processing(cutoff=8.0))
    parts = {"coulomb": friction.coulomb, "viscous": friction.viscous, "offset": friction.offset}
    effects = [parts[c.name.split(".")[0]][c.joint] for c in model.columns]
    truth = model.base.combination @ np.concatenate([links, effects])
    error = np.abs(fit.values - truth)
    return error / fit.std, error


def test_a_noisy_velocity_is_replaced_by_the_derivative(monkeypatch):
    standard, error = errors()
    monkeypatch.setattr(choice, "MUCH_LESS_NOISE", np.inf)  # use dq
    monkeypatch.setattr(choice, "LESS_NOISE", np.inf)
    biased, worse = errors()
    assert standard.max() < 4.0
    assert biased.max() > 2.0 * standard.max()
    assert np.linalg.norm(error) < 0.2 * np.linalg.norm(worse)
