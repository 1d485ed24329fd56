"""Recordings of a two-link arm with known torque, noise and disturbances."""

import numpy as np
from numpy.typing import NDArray

import lieid_casadi as lieid

Array = NDArray[np.float64]
RATE = 200.0
PERIOD = 6.0
EFFECTS = "coulomb,viscous,offset"


def motion(duration: float, *, seed: int = 0, still_after: float = np.inf):
    """Sum of harmonics of one period, both joints; joint 2 stops at ``still_after``."""
    t = np.arange(0.0, duration, 1.0 / RATE)
    random = np.random.default_rng(seed)
    q, dq, ddq = (np.zeros((len(t), 2)) for _ in range(3))
    for joint in range(2):
        for k in range(1, 5):
            w = 2.0 * np.pi * k / PERIOD
            a, phase = random.uniform(0.1, 0.4) / k, random.uniform(0.0, 6.3)
            q[:, joint] += a * np.sin(w * t + phase)
            dq[:, joint] += a * w * np.cos(w * t + phase)
            ddq[:, joint] -= a * w**2 * np.sin(w * t + phase)
    rest = t >= still_after
    if rest.any():
        q[rest, 1] = q[np.argmax(rest), 1]
        dq[rest, 1] = ddq[rest, 1] = 0.0
    return t, q, dq, ddq


def torque(q: Array, dq: Array, ddq: Array) -> Array:
    """Pinocchio's torque of the bundled arm, and friction: dry 3 and 1.5 N·m, viscous 2 and 0.8."""
    import pinocchio as pin

    from lieid_casadi.plant import build_pinocchio

    model = build_pinocchio(lieid.robots.two_link())
    data = model.createData()
    rigid = np.array([pin.rnea(model, data, *row) for row in zip(q, dq, ddq, strict=True)])
    return rigid + np.sign(dq) * [3.0, 1.5] + dq * [2.0, 0.8]


def recording(
    duration: float,
    *,
    seed: int = 0,
    noise: float | Array = 0.0,
    extra: Array | None = None,
    still_after: float = np.inf,
    name: str = "",
) -> lieid.Recording:
    """Measure the arm; noise is white of that size or given as (N, 2)."""
    t, q, dq, ddq = motion(duration, seed=seed, still_after=still_after)
    tau = torque(q, dq, ddq)
    if np.ndim(noise) == 0:
        noise = noise * np.random.default_rng(seed + 100).standard_normal(q.shape)
    tau = tau + noise + (0.0 if extra is None else extra)
    return lieid.Recording.from_arrays(t, q, dq, tau, name=name)


def fit(*trained: lieid.Recording, cutoff: float = 6.0, effects: str = EFFECTS) -> lieid.Fit:
    model = lieid.Model(lieid.robots.two_link(), effects)
    given = trained or (recording(24.0, seed=1, noise=0.2, name="train"),)
    return lieid.identify(model, given, processing=lieid.Processing(cutoff=cutoff))
