"""The regressor of a rigid arm on batches of instants.

The recursion of `lieid_casadi.dynamics.recursion` in NumPy, component first and instant last. It
tests hypotheses about robot and recording: each needs a few hundred instants of another arm, which
take a millisecond, where a compiled function would first take seconds of the compiler.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from lieid_casadi.arrays import Array, Indices
from lieid_casadi.dynamics.base_parameters import base_parameters
from lieid_casadi.robot import Robot

#: Gravity along no axis, m/s²: base parameters for it serve every direction.
ANY_GRAVITY = np.array([3.0, 5.0, -7.0])


@dataclass(frozen=True, eq=False)
class RigidArm:
    """The kept link parameters of an arm, and the constants of its joints."""

    robot: Robot
    kept: Indices
    combination: Array  # (k, 10 n) gives base parameters for gravity in any direction
    #: (12, 3) of each joint: pose in the frame before, over 1, sin q, 1 − cos q (or 1, q, 0)
    poses: tuple[Array, ...]
    own: tuple[Indices, ...]  # numbers of the columns of each link
    wrenches: tuple[Array, ...]  # (6 k, 12) force and moment of these, see `WRENCHES`

    @classmethod
    def of(cls, robot: Robot) -> RigidArm:
        """Return the arm of a robot, whose gravity is not used."""
        base = base_parameters(replace(robot, gravity=ANY_GRAVITY, source=None))
        kept = base.kept
        before, poses = np.eye(4), []
        for joint in robot.joints:
            twist = np.zeros((4, 4))  # screws have no pitch: they turn (ω·v = 0) or slide (ω = 0)
            twist[:3, :3], twist[:3, 3] = HAT @ joint.axis[:3], joint.axis[3:]
            start = np.linalg.solve(before, joint.home)
            terms = np.stack([start, start @ twist, start @ twist @ twist], axis=-1)
            poses.append(terms[:3].reshape(12, 3))
            before = joint.home
        own = tuple(np.flatnonzero(kept // 10 == i) for i in range(robot.n))
        wrenches = tuple(WRENCHES[:, kept[at] % 10].reshape(-1, 12) for at in own)
        return cls(robot, kept, base.combination, tuple(poses), own, wrenches)

    def columns(self, q: Array, dq: Array, ddq: Array, gravity: Array) -> Array:
        """Return columns (n, k, N) of the regressor; gravity (3,) or (3, N) in the base frame."""
        n, size = self.robot.n, len(q)
        made = np.zeros((n, len(self.kept), size))
        # in link axes: ω, α and acceleration, then v and ω of each screw
        carried = np.zeros((3, 3, size))
        carried[2] -= np.reshape(gravity, (3, -1))  # the base accelerates against gravity
        screws = np.zeros((2, n, 3, size))  # v and ω of each
        gradient = np.zeros((3, 3, size))  # of the acceleration in a link
        for i, joint in enumerate(self.robot.joints):
            x = q[:, i]
            turns = [np.sin(x), 1.0 - np.cos(x)] if joint.revolute else [x, np.zeros(size)]
            pose = (self.poses[i] @ [np.ones(size), *turns]).reshape(3, 4, size)
            rotation, position = pose[:, :3], pose[:, 3]
            carried[2] += np.einsum("ckn,kn->cn", gradient, position)
            hat = (HAT.reshape(9, 3) @ position).reshape(3, 3, size)
            v, z = screws[:, :i]
            every = _times(np.concatenate([carried, v + _times(z, hat), z]), rotation)
            carried, screws[:, :i] = every[:3], every[3:].reshape(2, i, 3, size)
            axis, shift = joint.axis[:3, None], joint.axis[3:, None]
            turn = axis * dq[:, i]
            carried[1] += _cross(carried[0], turn) + axis * ddq[:, i]
            if shift.any():
                slide = _cross(2.0 * carried[0] + turn, shift * dq[:, i])
                carried[2] += slide + shift * ddq[:, i]
            carried[0] += turn
            screws[0, i], screws[1, i] = shift, axis
            omega, alpha, acceleration = carried
            state = np.concatenate([acceleration, alpha, omega[SQUARES[0]] * omega[SQUARES[1]]])
            gradient = (GRADIENT @ state).reshape(3, 3, size)
            wrenches = (self.wrenches[i] @ state).reshape(6, -1, size)
            twists = screws[:, : i + 1].transpose(1, 0, 2, 3).reshape(i + 1, 6, size)
            made[: i + 1, self.own[i]] = _times(twists, wrenches)
        return made


def _times(x: Array, matrix: Array) -> Array:
    """Return the rows x (a, k, N) times matrices (k, c, N), instant by instant."""
    return np.asarray(np.einsum("akn,kcn->acn", x, matrix))


def _cross(a: Array, b: Array) -> Array:
    """Return a × b of vectors (3, N), faster than NumPy's for a few hundred."""
    x, y, z = a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]
    return np.array([x, y, z])


def _wrenches(a: Array, alpha: Array, square: Array) -> Array:
    """Return force and moment (6, 10) of the link parameters; ``square`` as in `SQUARES`."""
    x, y, z = alpha
    xx, yy, zz, xy, xz, yz = square
    gradient = [[-yy - zz, xy - z, xz + y], [xy + z, -xx - zz, yz - x], [xz - y, yz + x, -xx - yy]]
    moments = [  # I·α + ω × I·ω
        [x, y - xz, -yz, z + xy, yy - zz, yz],
        [xz, x + yz, y, zz - xx, z - xy, -xz],
        [-xy, xx - yy, xy, x - yz, y + xz, z],
    ]
    made = np.zeros((6, 10))
    made[:3, 0], made[:3, 1:4] = a, gradient
    made[3:, 1:4], made[3:, 4:] = (HAT @ a).T, moments
    return made


#: w ↦ ŵ, as (3, 3, 3).
HAT = np.cross(np.eye(3)[:, None], np.eye(3)[None]).transpose(2, 1, 0)
#: Factors of xx, yy, zz, xy, xz, yz.
SQUARES = np.array([[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]])
#: Force and moment of the link parameters (6, 10, 12), linear in what `_wrenches` takes.
WRENCHES = np.stack([_wrenches(*np.split(e, [3, 6])) for e in np.eye(12)], axis=-1)
GRADIENT = WRENCHES[:3, 1:4].reshape(9, 12)
