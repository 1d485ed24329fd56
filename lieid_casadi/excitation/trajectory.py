"""Trajectories: linear combinations of a basis, at rest at both ends, and their files."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Literal, Protocol, get_args

import numpy as np
from numpy.typing import NDArray

from lieid_casadi.arrays import Array
from lieid_casadi.atomic_file import require_regular
from lieid_casadi.errors import ExcitationError

LONGEST = 3600.0  # s, of one period
DEGREE = 5  # of the splines, and of the polynomial of the modified Fourier series
DEPENDENT = 1e-9  # part of a row, beyond the rows before it, below which it adds no condition


class Basis(Protocol):
    """Functions of time over one period, of which a trajectory is a linear combination.

    Column 0 is the constant 1. A basis of your own has these four members and is picklable where
    an executor is used.
    """

    @property
    def name(self) -> str:
        """Name in files."""

    @property
    def duration(self) -> float:
        """Length of one period, s."""

    @property
    def size(self) -> int:
        """Number of functions m."""

    def evaluate(self, t: Array) -> Array:
        """Return the functions and their first three derivatives (4, N, m) at t (N,) in s."""


@dataclass(frozen=True)
class Fourier:
    """Finite Fourier series (Eq. 19); periodic.

    Functions 1, sin(kωt)/(kω) for the coefficients a_k, −cos(kωt)/(kω) for b_k, so that a_k and
    b_k are amplitudes of velocity (rad/s). ``harmonics`` is H, ``duration`` the period in s.
    """

    harmonics: int = 5
    duration: float = 20.0
    name = "fourier"

    @property
    def size(self) -> int:
        """Number of functions: 2 H + 1."""
        return 2 * self.harmonics + 1

    def evaluate(self, t: Array) -> Array:
        """Return the functions and three derivatives (4, N, m)."""
        rates = 2.0 * np.pi / self.duration * np.arange(1, self.harmonics + 1)
        angles = np.outer(t, rates)
        sine, cosine = np.sin(angles), np.cos(angles)
        one, zero = np.ones((len(t), 1)), np.zeros((len(t), 1))
        kinds = [
            (one, sine / rates, -cosine / rates), (zero, cosine, sine),
            (zero, -sine * rates, cosine * rates), (zero, -cosine * rates**2, -sine * rates**2),
        ]  # fmt: skip
        return np.stack([np.hstack(kind) for kind in kinds])


@dataclass(frozen=True)
class ModifiedFourier:
    """Fourier series plus a polynomial of degree 5 that meets the end conditions.

    As in W. Wu, S. Zhu, X. Wang, H. Liu, "Closed-loop dynamic parameter identification of robot
    manipulators using modified Fourier series", IJARS 2012: the end conditions reduce the freedom
    of the polynomial in place of that of the harmonics. ``harmonics`` is H, ``duration`` the
    period in s.
    """

    harmonics: int = 5
    duration: float = 20.0
    name = "modified_fourier"

    @property
    def size(self) -> int:
        """Number of functions: 2 H + 6."""
        return 2 * self.harmonics + 1 + DEGREE

    def evaluate(self, t: Array) -> Array:
        """Return the functions and three derivatives (4, N, m)."""
        series = Fourier(self.harmonics, self.duration).evaluate(t)
        # powers of u ∈ [−1, 1] have the same size
        u, rate = 2.0 * t / self.duration - 1.0, 2.0 / self.duration
        k = np.arange(1, DEGREE + 1)
        powers = u[:, None] ** k
        first = rate * k * u[:, None] ** (k - 1)
        second = rate**2 * k * (k - 1) * u[:, None] ** np.maximum(k - 2, 0)
        third = rate**3 * k * (k - 1) * (k - 2) * u[:, None] ** np.maximum(k - 3, 0)
        return np.concatenate([series, np.stack([powers, first, second, third])], axis=2)


@dataclass(frozen=True)
class BSpline:
    """Uniform quintic B-spline; not periodic, with continuous jerk and fourth derivative.

    Each coefficient acts on six intervals only, so that a limit at one time does not restrain the
    motion at another. For a bound on the jerk beside it see `jerk_limit`. The ``intervals`` have
    equal length; ``duration`` is that of all, s.
    """

    intervals: int = 11
    duration: float = 20.0
    name = "bspline"

    @property
    def size(self) -> int:
        """Number of functions: the constant and all B-splines except one (they sum to 1)."""
        return self.intervals + DEGREE

    @cached_property
    def _knots(self) -> Array:
        inner = np.linspace(0.0, self.duration, self.intervals + 1)
        ends = np.ones(DEGREE)
        return np.concatenate([0.0 * ends, inner, self.duration * ends])

    def evaluate(self, t: Array) -> Array:
        """Return the functions and three derivatives (4, N, m)."""
        from scipy.interpolate import BSpline

        splines = BSpline(self._knots, np.eye(self.intervals + DEGREE), DEGREE)
        values = np.stack([splines(t), splines(t, 1), splines(t, 2), splines(t, 3)])
        values[:, :, 0] = 0.0
        values[0, :, 0] = 1.0
        return np.asarray(values)


BasisName = Literal["fourier", "modified_fourier", "bspline"]
NAMES: tuple[BasisName, ...] = get_args(BasisName)


def make(name: str = "fourier", *, duration: float = 20.0, harmonics: int = 5) -> Basis:
    """Return the basis of a name.

    A B-spline has as many free coefficients as the Fourier series of ``harmonics``: it needs six
    end conditions in place of three.
    """
    if not 0.0 < duration <= LONGEST:
        raise ExcitationError(
            f"duration: {duration:g} s; expected a positive number of at most {LONGEST:g} s"
        )
    if not 2 <= harmonics <= 100:
        raise ExcitationError(f"harmonics: {harmonics}; expected 2 to 100")
    if name == "fourier":
        return Fourier(harmonics, duration)
    if name == "modified_fourier":
        return ModifiedFourier(harmonics, duration)
    if name == "bspline":
        return BSpline(2 * harmonics - 1, duration)
    raise ExcitationError(f"basis: {name!r}; expected one of {', '.join(NAMES)}")


def check_basis(basis: Basis) -> None:
    """Refuse a basis without the properties that `Basis` states."""
    if not 0.0 < basis.duration <= LONGEST:
        raise ExcitationError(
            f"basis {basis.name}: duration {basis.duration:g} s; expected a positive number of at "
            f"most {LONGEST:g} s"
        )
    values = np.asarray(basis.evaluate(np.array([0.0, basis.duration])), dtype=float)
    if values.shape != (4, 2, basis.size):
        raise ExcitationError(
            f"basis {basis.name}: evaluate at two times has shape {values.shape}; expected "
            f"(4, 2, {basis.size}): functions and three derivatives, times, functions"
        )
    if not np.allclose(values[:, :, 0], np.array([[1.0], [0.0], [0.0], [0.0]])):
        raise ExcitationError(f"basis {basis.name}: column 0 is not the constant 1")


@dataclass(frozen=True, eq=False)
class MotionSamples:
    """Samples of a motion: t (N,) in s; q, dq, ddq (N, n) in rad (m), and the jerk where known."""

    t: Array
    q: Array
    dq: Array
    ddq: Array
    dddq: Array | None = None

    def __len__(self) -> int:
        return len(self.t)

    def at(self, index: NDArray[np.intp] | slice) -> MotionSamples:
        """Return some of the samples."""
        jerk = None if self.dddq is None else self.dddq[index]
        return MotionSamples(self.t[index], self.q[index], self.dq[index], self.ddq[index], jerk)


@dataclass(frozen=True, eq=False)
class Trajectory:
    """One period of a joint motion, q(t) = functions(t) @ coefficientsᵀ; coefficients (n, m)."""

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
    """Free variables z (n d,) of the trajectories that start and end at rest at a pose (Eq. 20).

    The conditions are linear: the coefficients are those of the pose at rest plus null-space
    directions times z. ``size_of_unit`` (n, 3) are position, velocity and acceleration that the
    scaled directions reach at z = 1.
    """

    basis: Basis
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
        functions = self.basis.evaluate(grid)[:3] @ self._directions
        peaks = np.abs(functions).max(axis=1)  # (3, d)
        return np.asarray(1.0 / (peaks[None] / self.size_of_unit[:, :, None]).max(axis=1))

    def functions(self, t: Array) -> Array:
        """Return ∂(q, dq, ddq, dddq)_j/∂z_j (n, 4, N, d) at times t (N,), s."""
        plain = self.basis.evaluate(t) @ self._directions
        return np.asarray(plain[None] * self.scales[:, None, None, :])

    def trajectory(self, z: Array) -> Trajectory:
        """Return the trajectory of free variables (n d,)."""
        free = np.reshape(z, (self.n, -1)) * self.scales
        coefficients = free @ self._directions.T
        coefficients[:, 0] += self.pose
        return Trajectory(self.basis, coefficients)

    def nearest(self, positions: Array) -> Array:
        """Return the free variables (n d,) of the trajectory nearest to positions (N, n).

        The positions are equidistant in time and taken as one period.
        """
        t = np.linspace(0.0, self.basis.duration, len(positions))
        functions = self.functions(t)[:, 0]  # (n, N, d)
        moved = positions - self.pose
        return np.concatenate(
            [np.linalg.lstsq(f, q, rcond=None)[0] for f, q in zip(functions, moved.T, strict=True)]
        )


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


def load_positions(path: str | Path, n: int) -> Array:
    """Return the positions (N, n) of a trajectory file, equidistant in time.

    The file is a CSV with the columns t, q1 … qn, as ``trajectory.csv``; lines with # precede the
    header. An `ExcitationError` names what is missing.
    """
    try:
        require_regular(path)
        lines = Path(path).read_text("utf-8").splitlines()
    except (OSError, UnicodeDecodeError) as error:
        raise ExcitationError(f"start: {path} cannot be read: {error}") from None
    rows = [line for line in lines if line.strip() and not line.startswith("#")]
    header = rows[0].split(",") if rows else []
    names = ["t", *(f"q{j + 1}" for j in range(n))]
    missing = [name for name in names if name not in header]
    if missing:
        raise ExcitationError(f"start: {path} has no column {missing[0]}; expected t, q1 … q{n}")
    try:
        columns = [header.index(name) for name in names]
        table = np.loadtxt(rows[1:], delimiter=",", usecols=columns, ndmin=2)
    except ValueError as error:
        raise ExcitationError(f"start: {path}: {error}") from None
    t = table[:, 0]
    if len(t) < 3 or not np.isfinite(table).all() or not np.all(np.diff(t) > 0.0):
        raise ExcitationError(
            f"start: {path}: expected 3 rows of finite numbers at least, with increasing times"
        )
    grid = np.linspace(t[0], t[-1], len(t))
    return np.column_stack([np.interp(grid, t, q) for q in table[:, 1:].T])


def csv_text(motion: MotionSamples, checked: Sequence[str], unchecked: Sequence[str]) -> str:
    """Return t, q1 … qn, dq1 … dqn, ddq1 … ddqn, one row per sample; 12 digits.

    What was checked, and what was not, precedes the header in lines that begin with ``#``.
    """
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


def joint_trajectory_yaml(motion: MotionSamples, names: Sequence[str]) -> str:
    """Return a ``trajectory_msgs/msg/JointTrajectory`` as ``ros2 topic pub`` reads it."""
    lines = ["joint_names: [" + ", ".join(json.dumps(name) for name in names) + "]", "points:"]
    for k, t in enumerate(motion.t):
        seconds = int(np.floor(t + 5e-10))
        nanoseconds = max(0, round((t - seconds) * 1e9))
        lines += [
            f"- positions: {_numbers(motion.q[k])}",
            f"  velocities: {_numbers(motion.dq[k])}",
            f"  accelerations: {_numbers(motion.ddq[k])}",
            f"  time_from_start: {{sec: {seconds}, nanosec: {nanoseconds}}}",
        ]
    return "\n".join(lines) + "\n"


def _numbers(values: Array) -> str:
    # "1e-05" is text in YAML 1.1; with a point it is a number
    return "[" + ", ".join(f"{value:.9f}" for value in values.tolist()) + "]"
