"""Trajectories as coefficients of a basis, with the end conditions eliminated (Eqs. 19-20)."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from lieid_casadi.excitation.basis.families import Basis

Array = NDArray[np.float64]
DEPENDENT = 1e-9  # part of a row, beyond the rows before it, below which it adds no condition


@dataclass(frozen=True, eq=False)
class MotionSamples:
    """Samples of a motion.

    Attributes
    ----------
    t : (N,)
        Time, s.
    q, dq, ddq : (N, n)
        Joint positions, velocities and accelerations: rad, rad/s, rad/s²; m for prismatic joints.
    dddq : (N, n) or None
        Jerk, rad/s³, where it is known.
    """

    t: Array
    q: Array
    dq: Array
    ddq: Array
    dddq: Array | None = None

    def __len__(self) -> int:
        return len(self.t)

    def at(self, index: NDArray[np.intp]) -> MotionSamples:
        """Return some of the samples."""
        jerk = None if self.dddq is None else self.dddq[index]
        return MotionSamples(self.t[index], self.q[index], self.dq[index], self.ddq[index], jerk)


@dataclass(frozen=True, eq=False)
class Trajectory:
    """One period of a joint motion, q(t) = functions(t) @ coefficientsᵀ.

    Attributes
    ----------
    basis : Basis
    coefficients : (n, m)
        Of the functions of the basis; for `Fourier`: q₀, a_1 … a_H, b_1 … b_H.
    """

    basis: Basis
    coefficients: Array

    @property
    def duration(self) -> float:
        """Length of the period, s."""
        return self.basis.duration

    def at(self, t: Array) -> MotionSamples:
        """Return the motion at times within the period."""
        time = np.asarray(t, dtype=float)
        functions = self.basis.evaluate(time)
        return MotionSamples(time, *(kind @ self.coefficients.T for kind in functions))


def period_grid(duration: float, samples: int) -> Array:
    """Return equidistant times (samples,) over one period, without its end."""
    return duration * np.arange(samples) / samples


@dataclass(frozen=True, eq=False)
class Parametrization:
    """Free variables z (n d,) of the trajectories that meet the end conditions.

    At both ends velocity and acceleration vanish (Eq. 20) and the positions are the same; with
    ``fixed`` they are ``pose``, otherwise free. The conditions are linear: the coefficients are
    those of the pose at rest plus null-space directions times z.

    Attributes
    ----------
    basis : Basis
    pose : (n,)
        Start pose, or the pose at z = 0; rad.
    fixed : bool
    size_of_unit : (n, 3)
        Position, velocity and acceleration that the scaled directions reach at z = 1.
    """

    basis: Basis
    pose: Array
    fixed: bool
    size_of_unit: Array

    @property
    def n(self) -> int:
        """Number of joints."""
        return len(self.pose)

    @property
    def directions_per_joint(self) -> int:
        """Free variables of one joint d."""
        return int(self._directions.shape[1])

    @property
    def size(self) -> int:
        """Number of free variables."""
        return self.n * self.directions_per_joint

    @cached_property
    def _directions(self) -> Array:
        """Orthonormal null space (m, d) of the end conditions."""
        ends = self.basis.evaluate(np.array([0.0, self.basis.duration]))
        kinds = (0, 1, 2) if self.fixed else (1, 2)
        # a duration of one in place of seconds makes the conditions comparable
        conditions = [ends[k] * self.basis.duration**k for k in kinds]
        closing = ends[0, 1] - ends[0, 0]
        if not self.fixed and np.abs(closing).max() > DEPENDENT:  # periodic bases close anyway
            conditions.append(closing[None])
        return null_space(np.vstack(conditions))

    @cached_property
    def scales(self) -> Array:
        """Length (n, d) of each direction, such that a unit of z reaches about one limit."""
        grid = period_grid(self.basis.duration, 200)
        functions = self.basis.evaluate(grid)[:3] @ self._directions
        peaks = np.abs(functions).max(axis=1)  # (3, d)
        return np.asarray(1.0 / (peaks[None] / self.size_of_unit[:, :, None]).max(axis=1))

    def functions(self, t: Array) -> Array:
        """Return ∂(q, dq, ddq, dddq)_j/∂z_j (n, 4, N, d) at times t (N,), s."""
        plain = self.basis.evaluate(t) @ self._directions
        return np.asarray(plain[None] * self.scales[:, None, None, :])

    def coefficients(self, z: Array) -> Array:
        """Return the coefficients (n, m) of free variables (n d,)."""
        free = np.reshape(z, (self.n, -1)) * self.scales
        coefficients = free @ self._directions.T
        coefficients[:, 0] += self.pose
        return coefficients

    def trajectory(self, z: Array) -> Trajectory:
        """Return the trajectory of free variables (n d,)."""
        return Trajectory(self.basis, self.coefficients(z))

    def variables(self, trajectory: Trajectory) -> Array:
        """Return the free variables (n d,) of a trajectory of this basis (its projection)."""
        coefficients = trajectory.coefficients.copy()
        coefficients[:, 0] -= self.pose
        return np.ravel((coefficients @ self._directions) / self.scales)


def null_space(rows: Array) -> Array:
    """Return an orthonormal null space (m, d) of rows (k, m) that rounding does not rotate.

    The singular vectors of a null space are arbitrary up to a rotation. The one returned by a
    linear-algebra library depends on the processor, and with it every random start. Here it is the
    orthonormal basis nearest to fixed reference directions (orthogonal Procrustes problem), a
    smooth function of the rows.
    """
    projector = np.eye(rows.shape[1])
    for row in rows:
        rest = projector @ row
        if np.linalg.norm(rest) > DEPENDENT * np.linalg.norm(row):
            unit = rest / np.linalg.norm(rest)
            projector = projector - np.outer(unit, unit)
    free = round(float(np.trace(projector)))
    reference = np.random.default_rng(0).normal(size=(rows.shape[1], free))
    near = projector @ reference
    left, _, right = np.linalg.svd(near, full_matrices=False)
    return np.asarray(left @ right)


@dataclass(frozen=True, eq=False)
class SampledBasis:
    """A parametrization at fixed times: motions of z and gradients by matrix products."""

    parametrization: Parametrization
    t: Array

    @cached_property
    def functions(self) -> Array:
        """∂(q, dq, ddq, dddq)_j/∂z_j (n, 4, N, d)."""
        return self.parametrization.functions(self.t)

    @cached_property
    def _flat(self) -> Array:
        n, kinds, samples, d = self.functions.shape
        return np.ascontiguousarray(self.functions.reshape(n, kinds * samples, d))

    def motion(self, z: Array) -> MotionSamples:
        """Return the motion of free variables (n d,) at the times."""
        p = self.parametrization
        free = np.reshape(z, (p.n, -1, 1))
        values = (self._flat @ free).reshape(p.n, 4, len(self.t))
        values[:, 0] += p.pose[:, None]
        return MotionSamples(self.t, *(np.ascontiguousarray(values[:, k].T) for k in range(4)))

    def gradient(self, gradients: Array) -> Array:
        """Return ∂f/∂z (n d,) of gradients (n, 3, N) with respect to the motion."""
        n = self.parametrization.n
        flat = gradients.reshape(n, 1, -1)
        return np.ravel(flat @ self._flat[:, : flat.shape[2]])
