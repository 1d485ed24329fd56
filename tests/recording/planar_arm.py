"""A planar arm with two joints under gravity, in closed form, moving periodically."""

import numpy as np

from lieid_casadi.recording import Recording

PERIOD = 8.0
COULOMB, VISCOUS = np.array([3.0, 1.0]), np.array([2.0, 0.5])


def motion(t, period=PERIOD):
    """q, dq, ddq (N, 2): sums of harmonics, different on the two joints."""
    w = 2 * np.pi / period
    terms = [[(0.8, 1, 0.3), (0.35, 2, 1.1), (0.1, 5, 0.0)], [(0.6, 1, 2.0), (0.3, 3, 0.4)]]
    q, dq, ddq = (np.zeros((t.size, 2)) for _ in range(3))
    for j, harmonics in enumerate(terms):
        for a, k, phase in harmonics:
            q[:, j] += a * np.sin(k * w * t + phase)
            dq[:, j] += a * k * w * np.cos(k * w * t + phase)
            ddq[:, j] -= a * (k * w) ** 2 * np.sin(k * w * t + phase)
    return q, dq, ddq


def rigid_torque(q, dq, ddq):
    """Torque of two uniform rods of 1 m in a vertical plane (4 kg, 2 kg), N·m."""
    m1, m2, g = 4.0, 2.0, 9.81
    c2, s2 = np.cos(q[:, 1]), np.sin(q[:, 1])
    a, b, d = m1 / 3 + m2 * 4 / 3, m2 / 2, m2 / 3
    tau1 = (a + 2 * b * c2) * ddq[:, 0] + (d + b * c2) * ddq[:, 1]
    tau1 -= b * s2 * (2 * dq[:, 0] * dq[:, 1] + dq[:, 1] ** 2)
    tau2 = (d + b * c2) * ddq[:, 0] + d * ddq[:, 1] + b * s2 * dq[:, 0] ** 2
    g2 = m2 * g / 2 * np.cos(q[:, 0] + q[:, 1])
    g1 = (m1 / 2 + m2) * g * np.cos(q[:, 0]) + g2
    return np.column_stack([tau1 + g1, tau2 + g2])


def measured(duration=24.0, rate=200.0, noise=1.0, seed=0, jitter=0.0, **fields):
    """Recording of the arm with friction and, times ``noise``, realistic sensor noise."""
    random = np.random.default_rng(seed)
    t = np.arange(round(duration * rate)) / rate
    t = t + jitter / rate * random.uniform(-0.5, 0.5, t.size)
    q, dq, ddq = motion(t)
    tau = rigid_torque(q, dq, ddq) + COULOMB * np.sign(dq) + VISCOUS * dq
    values = {
        "q": q + noise * 2e-5 * random.normal(size=q.shape),
        "dq": dq + noise * 2e-3 * random.normal(size=q.shape),
        "tau": tau + noise * 0.3 * random.normal(size=q.shape),
    }
    return Recording.from_arrays(t, **{**values, "name": "planar", **fields})
