"""Trajectories: finite Fourier series, at rest at both ends, and their files."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from lieid_casadi.arrays import Array, Indices
from lieid_casadi.errors import ExcitationError

LONGEST = 3600.0  # s, of one period
DEPENDENT = 1e-9  # part of a row, beyond the rows before it, below which it adds no condition


@dataclass(frozen=True)
class Fourier:
    """Finite Fourier series (Eq. 19); periodic.

    Functions 1, sin(kωt)/(kω) for the coefficients a_k, −cos(kωt)/(kω) for b_k, so that a_k and
    b_k are amplitudes of velocity (rad/s). ``harmonics`` is H, ``duration`` the period in s.
    """

    harmonics: int = 5
    duration: float = 20.0

    def __post_init__(self) -> None:
        if not 0.0 < self.duration <= LONGEST:
            raise ExcitationError(
                f"duration: {self.duration:g} s; expected a positive number of at most "
                f"{LONGEST:g} s"
            )
        if not 2 <= self.harmonics <= 100:
            raise ExcitationError(f"harmonics: {self.harmonics}; expected 2 to 100")

    @property
    def size(self) -> int:
        """Number of functions: 2 H + 1."""
        return 2 * self.harmonics + 1

    def evaluate(self, t: Array) -> Array:
        """Return the functions and two derivatives (3, N, m) at t (N,) in s."""
        rates = 2.0 * np.pi / self.duration * np.arange(1, self.harmonics + 1)
        angles = np.outer(t, rates)
        sine, cosine = np.sin(angles), np.cos(angles)
        one, zero = np.ones((len(t), 1)), np.zeros((len(t), 1))
        kinds = [
            (one, sine / rates, -cosine / rates), (zero, cosine, sine),
            (zero, -sine * rates, cosine * rates),
        ]  # fmt: skip
        return np.stack([np.hstack(kind) for kind in kinds])


@dataclass(frozen=True, eq=False)
class MotionSamples:
    """Samples of a motion: t (N,) in s; q, dq, ddq (N, n) in rad (m)."""

    t: Array
    q: Array
    dq: Array
    ddq: Array

    def __len__(self) -> int:
        return len(self.t)

    def at(self, index: Indices | slice) -> MotionSamples:
        """Return some of the samples."""
        return MotionSamples(self.t[index], self.q[index], self.dq[index], self.ddq[index])


@dataclass(frozen=True, eq=False)
class Trajectory:
    """One period of a joint motion, q(t) = functions(t) @ coefficientsᵀ; coefficients (n, m)."""

    basis: Fourier
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
    """Free variables z (n d,) of the trajectories that start and end at rest at a pose (Eq. 20).

    The conditions are linear: the coefficients are those of the pose at rest plus null-space
    directions times z. ``size_of_unit`` (n, 3) are position, velocity and acceleration that the
    scaled directions reach at z = 1.
    """

    basis: Fourier
    pose: Array
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
        # a duration of one in place of seconds makes the conditions comparable
        return null_space(np.vstack([ends[k] * self.basis.duration**k for k in (0, 1, 2)]))

    @cached_property
    def scales(self) -> Array:
        """Length (n, d) of each direction, such that a unit of z reaches about one limit."""
        grid = period_grid(self.basis.duration, 200)
        functions = self.basis.evaluate(grid) @ self._directions
        peaks = np.abs(functions).max(axis=1)  # (3, d)
        return np.asarray(1.0 / (peaks[None] / self.size_of_unit[:, :, None]).max(axis=1))

    def functions(self, t: Array) -> Array:
        """Return ∂(q, dq, ddq)_j/∂z_j (n, 3, N, d) at times t (N,), s."""
        plain = self.basis.evaluate(t) @ self._directions
        return np.asarray(plain[None] * self.scales[:, None, None, :])

    def trajectory(self, z: Array) -> Trajectory:
        """Return the trajectory of free variables (n d,)."""
        free = np.reshape(z, (self.n, -1)) * self.scales
        coefficients = free @ self._directions.T
        coefficients[:, 0] += self.pose
        return Trajectory(self.basis, coefficients)


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
    left, _, right = np.linalg.svd(projector @ reference, full_matrices=False)
    return np.asarray(left @ right)


@dataclass(frozen=True, eq=False)
class SampledBasis:
    """A parametrization at fixed times: motions of z and gradients by matrix products."""

    parametrization: Parametrization
    t: Array

    @cached_property
    def functions(self) -> Array:
        """∂(q, dq, ddq)_j/∂z_j (n, 3, N, d)."""
        return self.parametrization.functions(self.t)

    @cached_property
    def _flat(self) -> Array:
        n, kinds, samples, d = self.functions.shape
        return np.ascontiguousarray(self.functions.reshape(n, kinds * samples, d))

    def motion(self, z: Array) -> MotionSamples:
        """Return the motion of free variables (n d,) at the times."""
        p = self.parametrization
        free = np.reshape(z, (p.n, -1, 1))
        values = (self._flat @ free).reshape(p.n, 3, len(self.t))
        values[:, 0] += p.pose[:, None]
        return MotionSamples(self.t, *(np.ascontiguousarray(values[:, k].T) for k in range(3)))

    def gradient(self, gradients: Array) -> Array:
        """Return ∂f/∂z (n d,) of gradients (n, 3, N) with respect to the motion."""
        return np.ravel(gradients.reshape(self.parametrization.n, 1, -1) @ self._flat)


def csv_text(motion: MotionSamples, checked: Sequence[str], unchecked: Sequence[str]) -> str:
    """Return t, q1 … qn, dq1 … dqn, ddq1 … ddqn, one row per sample; 12 digits."""
    n = motion.q.shape[1]
    names = [f"{kind}{j + 1}" for kind in ("q", "dq", "ddq") for j in range(n)]
    table = np.column_stack([motion.t, motion.q, motion.dq, motion.ddq])
    row = ",".join(["%.12g"] * table.shape[1]) + "\n"
    return (
        "".join(f"# checked: {name}\n" for name in checked)
        + "".join(f"# not checked: {name}\n" for name in unchecked)
        + ",".join(["t", *names])
        + "\n"
        + "".join(row % tuple(values) for values in table.tolist())
    )
