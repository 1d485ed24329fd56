"""Torque uncertainty from dry friction, against Monte Carlo with random signs."""

import numpy as np
import pytest
from scipy.special import erf

import lieid_casadi as lieid
from lieid_casadi.identification.uncertainty.noise_model import dry_level, friction_torque_std
from lieid_casadi.recording import Processing, process

MODEL = lieid.Model(lieid.robots.two_link(), "coulomb,viscous,load_friction")
LEVELS = {"coulomb.f_c:1": 2.0, "coulomb.f_c:2": 0.5, "load_friction.f_tau:2": 0.1}


@pytest.fixture(scope="module")
def segment():
    t = np.arange(0.0, 10.0, 0.01)
    q = np.column_stack([np.sin(1.3 * t), 0.4 * np.cos(2.1 * t)])
    q[(t > 4.0) & (t < 6.0), 1] = q[np.argmax(t > 4.0), 1]
    noise = np.random.default_rng(1).normal(scale=2e-5, size=q.shape)
    recording = lieid.Recording.from_arrays(t, q + noise, tau=np.zeros_like(q))
    (only,) = process(recording, Processing(cutoff=6.0))
    return only


@pytest.fixture(scope="module")
def numbers():
    names = [column.label for column in MODEL.columns]
    coefficients = [LEVELS.get(name, 0.3 if "viscous" in name else 0.0) for name in names]
    return np.concatenate([MODEL.robot.link_parameters, coefficients])


def test_standard_deviation_is_that_of_random_signs(segment, numbers):
    compiled = lieid.compile(MODEL)
    found = friction_torque_std(compiled, segment, np.zeros(0), numbers)
    level = dry_level(compiled, segment, np.zeros(0), numbers)
    ahead = 0.5 * np.abs(segment.ddq) / segment.rate
    mean = erf(3.0 / np.sqrt(2.0) * segment.dq / np.hypot(segment.dead_zone, ahead))
    random = np.random.default_rng(2)
    drawn = []
    for _ in range(4000):
        sign = np.where(random.uniform(-1.0, 1.0, mean.shape) < mean, 1.0, -1.0)
        rest = random.uniform(-1.0, 1.0, (1, 2))  # constant during a rest
        drawn.append(segment.filter(np.where(segment.moving, sign - mean, rest) * level))
    spread = np.sqrt(np.mean(np.square(drawn), axis=0))
    rows = found > 0.15 * found.max(axis=0)
    assert 10 < rows[:, 0].sum() < 0.6 * len(rows)
    np.testing.assert_allclose(found[rows], spread[rows], rtol=0.25)
    assert np.all(np.abs(found - spread)[~rows] < 0.05 * found.max())
