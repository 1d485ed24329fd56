"""The other effect whose columns are most similar to a hidden one, by columns defined here.

If the columns of another effect explain nearly all of the unexplained torque of a hidden effect,
data of this noise cannot separate the two.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from hidden_effects.base_span import BaseSpan, NoiselessRecord
from numpy.typing import NDArray

Array = NDArray[np.float64]
SimilarColumns = tuple[str, tuple[int, ...], Array]


def most_similar(
    span: BaseSpan, left: Array, joint: int, truth: tuple[str, tuple[int, ...]], *, kept: bool
) -> tuple[str, float]:
    """Return the most similar effect on one joint and the part of ``left`` (R,) that it explains.

    With ``kept`` the base model is not fitted again, so that its columns are not projected out.
    """
    tried = [
        (name, joints, matrix)
        for name, joints, matrix in similar_columns(span.record, joint)
        if (name, joints) != truth
    ]
    values = np.zeros((*span.record.q.shape, sum(m.shape[1] for *_, m in tried)))
    values[:, joint] = np.concatenate([m for *_, m in tried], axis=1)
    stacked = span.stacked(values)
    projected = stacked if kept else span.outside(stacked)
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


def similar_columns(r: NoiselessRecord, j: int) -> Iterator[SimilarColumns]:
    """Yield name, joints and columns (K, m) of the effects of a library on joint j."""
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
