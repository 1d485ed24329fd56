"""The regressor of a rigid arm on batches of instants, with gravity as an input.

The recursion of `lieid_casadi.dynamics.recursion` in NumPy, component first and instant last. It
tests hypotheses about robot and recording: each needs a few hundred instants of another arm, which
take milliseconds, where a compiled function would first take seconds of the compiler.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from lieid_casadi.arrays import Array
from lieid_casadi.robot import Robot


@dataclass(frozen=True, eq=False)
class Rigid:
    """Columns of the link parameters at N instants.

    ``motion`` (n, 10 n, N) is without gravity; ``gravity`` (3, n, 4 n, N) has the columns of m and
    m·c of every link for unit gravity along x, y and z of the base frame.
    """

    motion: Array
    gravity: Array

    def columns(self, gravity: Array) -> Array:
        """Return the regressor (n, 10 n, N) for gravity (3,), m/s²."""
        n = len(self.motion)
        whole = self.motion.copy()
        links = whole.reshape(n, n, 10, -1)[:, :, :4]
        links += np.tensordot(gravity, self.gravity, axes=1).reshape(n, n, 4, -1)
        return whole


def rigid_columns(robot: Robot, q: Array, dq: Array, ddq: Array) -> Rigid:
    """Return the regressor of the link parameters, gravity apart; q, dq, ddq (N, n)."""
    n, size = robot.n, len(q)
    motion, gravity = np.zeros((n, n, 10, size)), np.zeros((3, n, n, 4, size))
    # in link axes: ω, α and acceleration, unit gravity along x, y, z, then ω and v of each screw
    carried = np.zeros((6, 3, size))
    carried[3:] = np.eye(3)[:, :, None]
    z, v = np.zeros((2, 0, 3, size))
    before = np.eye(4)
    for i, joint in enumerate(robot.joints):
        rotation, position = _relative_pose(before, joint.home, joint.axis, q[:, i])
        before = joint.home
        omega, alpha = carried[:2]
        carried[2] += _cross(alpha, position) + _cross(omega, _cross(omega, position))
        every = np.concatenate([carried, z, v - _cross(position, z)])
        every = _times(every, rotation)
        carried, z, v = every[:6], every[6 : 6 + i], every[6 + i :]
        axis, shift = joint.axis[:3, None], joint.axis[3:, None]
        turn, slide = axis * dq[:, i], shift * dq[:, i]
        carried[1] += _cross(carried[0], turn) + axis * ddq[:, i]
        carried[2] += _cross(2.0 * carried[0] + turn, slide) + shift * ddq[:, i]
        carried[0] += turn
        omega, alpha, acceleration = carried[:3]
        z = np.concatenate([z, np.broadcast_to(axis, (1, 3, size))])
        v = np.concatenate([v, np.broadcast_to(shift, (1, 3, size))])
        gradient = _hat(alpha) + _squared(omega)
        motion[: i + 1, i, 0] = _times(v, acceleration[:, None])[:, 0]
        motion[: i + 1, i, 1:4] = _times(v, gradient) + _cross(acceleration, z)
        motion[: i + 1, i, 4:] = _times(z, _moments(alpha, omega))
        falling = carried[3:]  # the base accelerates against gravity
        gravity[:, : i + 1, i, 0] = -_times(v, falling.transpose(1, 0, 2)).transpose(1, 0, 2)
        gravity[:, : i + 1, i, 1:] = -_cross(falling.transpose(1, 0, 2)[:, :, None], z[None])
    return Rigid(motion.reshape(n, 10 * n, size), gravity.reshape(3, n, 4 * n, size))


def _relative_pose(before: Array, home: Array, axis: Array, q: Array) -> tuple[Array, Array]:
    """Return rotation (3, 3, N) and position (3, N) of a link frame in the frame before it."""
    at_zero = np.linalg.solve(before, home)
    omega, v = axis[:3].astype(float), axis[3:].astype(float)
    hat = _hat(omega[:, None])[:, :, 0]
    sin, versin = np.sin(q), 1.0 - np.cos(q)
    if not omega.any():
        turned = np.repeat(np.eye(3)[:, :, None], len(q), axis=2)
        moved = v[:, None] * q
    else:
        turned = np.eye(3)[:, :, None] + hat[:, :, None] * sin + (hat @ hat)[:, :, None] * versin
        moved = (v[:, None] * sin) + (hat @ v)[:, None] * versin  # zero pitch: ω·v = 0
    rotation = np.einsum("ij,jkn->ikn", at_zero[:3, :3], turned)
    return rotation, at_zero[:3, 3:] + at_zero[:3, :3] @ moved


def _times(x: Array, matrix: Array) -> Array:
    """Return the rows x (a, 3, N) times matrices (3, c, N), instant by instant."""
    return np.asarray(sum(x[:, k, None] * matrix[k] for k in range(3)))


def _cross(a: Array, b: Array) -> Array:
    """Return a × b for a (3, …, N), whose first axis is that of the components, and b (…, 3, N)."""
    x, y, z = b[..., 0, :], b[..., 1, :], b[..., 2, :]
    product = np.empty((*np.broadcast_shapes(a.shape[1:], x.shape)[:-1], *b.shape[-2:]))
    product[..., 0, :] = a[1] * z - a[2] * y
    product[..., 1, :] = a[2] * x - a[0] * z
    product[..., 2, :] = a[0] * y - a[1] * x
    return product


def _hat(w: Array) -> Array:
    zero = np.zeros_like(w[0])
    return np.array([[zero, -w[2], w[1]], [w[2], zero, -w[0]], [-w[1], w[0], zero]])


def _squared(w: Array) -> Array:
    """Return ω̂² (3, 3, N)."""
    square = np.einsum("in,jn->ijn", w, w) - np.eye(3)[:, :, None] * np.sum(w * w, axis=0)
    return np.asarray(square)


def _moments(alpha: Array, omega: Array) -> Array:
    """Return I·α + ω × I·ω (3, 6, N) per element of the inertia: xx, xy, yy, xz, yz, zz."""
    x, y, z = omega
    xx, yy, zz, xy, xz, yz = x * x, y * y, z * z, x * y, x * z, y * z
    a, b, c = alpha
    zero = np.zeros_like(a)
    return np.array(
        [
            [a, b - xz, -yz, c + xy, yy - zz, yz],
            [xz, a + yz, b, zz - xx, c - xy, -xz],
            [-xy, xx - yy, xy, a - yz, b + xz, c + zero],
        ]
    )
