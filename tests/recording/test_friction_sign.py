"""Signs of torque and velocity from friction alone, over draws of motion and noise."""

import numpy as np
import pytest
from scipy.signal import lfilter

from lieid_casadi import errors
from lieid_casadi.recording import Recording
from lieid_casadi.recording.consistency import block_means, check_torque

JOINTS, RATE, DURATION = 7, 100.0, 20.0
VISCOUS = np.linspace(1.0, 0.2, JOINTS)


def drawn(seed: int, coulomb: float, viscous: float) -> Recording:
    """Return a recording of a light arm on one period of a Fourier motion.

    Its velocities are almost sums of the columns that stand for gravity. The torque has parts that
    no column describes (sines of sums of three angles, products of velocities), and the noise is
    correlated.
    """
    random = np.random.default_rng([seed, 12])
    t = np.arange(0.0, DURATION, 1.0 / RATE)
    k = 2.0 * np.pi / DURATION * np.arange(1, 6)[:, None, None]
    size, phase = random.normal(size=(5, 1, JOINTS)), random.uniform(0, 6.28, (5, 1, JOINTS))
    scale = 0.5 / np.abs(size).sum(axis=0)
    angle = k * t[:, None] + phase
    q, dq, ddq = (
        scale * np.sum(x, axis=0)
        for x in (size * np.sin(angle), size * k * np.cos(angle), -size * k**2 * np.sin(angle))
    )
    three = q + np.roll(q, 1, axis=1) + np.roll(q, 2, axis=1)
    rigid = np.sin(q) + 0.2 * np.sin(three) + 0.2 * ddq + 0.2 * dq * np.roll(dq, 1, axis=1)
    noise = lfilter([1.0], [1.0, -0.9], random.normal(0.0, 0.05, q.shape), axis=0)
    tau = rigid + coulomb * np.sign(dq) + viscous * VISCOUS * dq + noise
    return Recording(t=t, q=q, dq=dq, tau=tau)


def joints_reported(recording: Recording) -> int:
    """Return the number of joints whose friction is reported to drive them."""
    found = check_torque(recording, block_means(recording), None)
    texts = [str(w) for w in found if isinstance(w, errors.TorqueSignWarning)]
    return sum(text.partition("of joint")[2].count(str(j + 1)) for text in texts for j in range(7))


@pytest.mark.parametrize(("coulomb", "viscous"), [(0.5, 1.0), (0.5, 0.0), (0.0, 0.0), (0.1, 0.3)])
def test_friction_of_the_right_sign_causes_no_warning(coulomb, viscous):
    assert sum(joints_reported(drawn(k, coulomb, viscous)) for k in range(8)) == 0


def test_friction_of_the_wrong_sign_is_reported():
    found = sum(joints_reported(drawn(k, -0.5, -1.0)) for k in range(8))
    assert found >= 0.98 * 8 * JOINTS
