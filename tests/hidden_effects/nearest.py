"""Which other effect of a library imitates a hidden one best, by columns written out here.

It tells how fair a case is: where another effect's columns explain nearly all of what a hidden
effect leaves, no data of this noise can tell the two apart.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from hidden_effects.sizes import Clean, Space
from numpy.typing import NDArray

Array = NDArray[np.float64]
Imitation = tuple[str, tuple[int, ...], Array]


def nearest(
    space: Space, left: Array, joint: int, truth: tuple[str, tuple[int, ...]], *, kept: bool
) -> tuple[str, float]:
    """Return the best imitation on one joint and the part of ``left`` (R,) that it explains.

    ``kept``: the base model is not fitted again, so that nothing is projected off it.
    """
    tried = [
        (name, joints, matrix)
        for name, joints, matrix in imitations(space.record, joint)
        if (name, joints) != truth
    ]
    values = np.zeros((*space.record.q.shape, sum(m.shape[1] for *_, m in tried)))
    values[:, joint] = np.concatenate([m for *_, m in tried], axis=1)
    stacked = space.stacked(values)
    projected = stacked if kept else space.left(stacked)
    present = np.linalg.norm(projected, axis=0) > 1e-6 * np.linalg.norm(stacked, axis=0)
    best, part, first = "", 0.0, 0
    whole = float(left @ left)
    for name, joints, matrix in tried:
        own = slice(first, first + matrix.shape[1])
        first = own.stop
        columns = projected[:, own]
        if not whole or not present[own].all():
            continue  # absorbed
        gram, along = columns.T @ columns, columns.T @ left
        explained = float(along @ np.linalg.lstsq(gram, along, rcond=None)[0]) / whole
        if explained > part:
            best, part = f"{name}:{'<'.join(str(k + 1) for k in joints)}", explained
    return best, part


def imitations(r: Clean, j: int) -> Iterator[Imitation]:
    """Yield name, joints and columns (K, m) of a library's effects on joint j."""
    q, dq, sign = r.q[:, j], r.dq[:, j], np.sign(r.dq[:, j])
    here, fast = (j,), float(np.abs(dq).max()) + 1e-9
    yield "coulomb", here, sign[:, None]
    yield "viscous", here, dq[:, None]
    yield "offset", here, np.ones((len(q), 1))
    yield "viscous_polynomial", here, np.column_stack([sign * dq**2, dq**3])
    yield "viscous_asymmetric", here, np.abs(dq)[:, None]
    for v in fast * np.geomspace(0.01, 0.7, 12):
        yield "stribeck", here, (sign * np.exp(-((dq / v) ** 2)))[:, None]
    yield "load_friction", here, (np.abs(r.load[:, j]) * sign)[:, None]
    for k in np.arange(0.5, 8.1, 0.25):
        waves = np.column_stack([np.sin(k * q), np.cos(k * q)])
        yield "position_friction", here, waves * sign[:, None]
    for k in np.concatenate([np.arange(1.75, 20.0, 0.25), np.arange(20.0, 121.0, 1.0)]):
        yield "torque_ripple", here, np.column_stack([np.sin(k * q), np.cos(k * q)])
    yield "armature", here, r.ddq[:, j, None]
    yield "position_spring", here, q[:, None]
    yield "bias_drift", here, (r.t - r.t.mean())[:, None]
    yield "torque_gain", here, r.tau[:, j, None]
    yield "torque_delay", here, np.gradient(r.tau[:, j], r.t)[:, None]
    for theta in np.geomspace(0.1, 1.0, 4) * float(r.t[-1] - r.t[0]):
        warmed = 1.0 - np.exp(-r.t / theta)
        yield "warm_up", here, np.column_stack([warmed * sign, warmed * dq])
    for i in range(r.q.shape[1]):
        if i != j:
            other = np.column_stack([r.dq[:, i], np.sign(r.dq[:, i])])
            yield "transmission_coupling", (j, i), other
    for width in np.geomspace(0.003, 0.3, 7):
        yield "presliding", here, (_dahl(q, width) - sign)[:, None]


def _dahl(q: Array, width: float) -> Array:
    z, steps = np.zeros(len(q)), np.diff(q)
    for k, step in enumerate(steps):
        toward = np.sign(step)
        z[k + 1] = toward + (z[k] - toward) * np.exp(-abs(step) / width)
    return z
