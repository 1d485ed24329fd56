"""Bases of trajectories: Fourier series and B-splines."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Literal, Protocol, get_args

import numpy as np
from numpy.typing import NDArray

from lieid_casadi.errors import ExcitationError

Array = NDArray[np.float64]
LONGEST = 3600.0  # s, of one period
DEGREE = 5  # of the splines, and of the polynomial of the modified Fourier series


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
    b_k are amplitudes of velocity (rad/s).

    Parameters
    ----------
    harmonics : int
        H, of the period's frequency.
    duration : float
        Period, s.
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
        return np.stack(
            [
                np.hstack([one, sine / rates, -cosine / rates]),
                np.hstack([zero, cosine, sine]),
                np.hstack([zero, -sine * rates, cosine * rates]),
                np.hstack([zero, -cosine * rates**2, -sine * rates**2]),
            ]
        )


@dataclass(frozen=True)
class ModifiedFourier:
    """Fourier series plus a polynomial of degree 5 that meets the end conditions.

    As in W. Wu, S. Zhu, X. Wang, H. Liu, "Closed-loop dynamic parameter identification of robot
    manipulators using modified Fourier series", IJARS 2012: the end conditions reduce the freedom
    of the polynomial in place of that of the harmonics.

    Parameters
    ----------
    harmonics : int
        H, of the period's frequency.
    duration : float
        Period, s.
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
    motion at another. For a bound on the jerk beside it see `jerk_limit`.

    Parameters
    ----------
    intervals : int
        Of equal length.
    duration : float
        Of all intervals, s.
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


def check_basis(basis: Basis) -> None:
    """Refuse a basis without the properties that `Basis` states.

    Raises
    ------
    ExcitationError
        Names what was found.
    """
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


def make(
    name: str = "fourier",
    *,
    duration: float = 20.0,
    harmonics: int = 5,
    intervals: int | None = None,
) -> Basis:
    """Return the basis of a name.

    Parameters
    ----------
    name : str
        ``fourier`` (Eq. 19), ``modified_fourier`` or ``bspline``.
    duration : float
        Of one period, s.
    harmonics : int
        Of the Fourier series.
    intervals : int, optional
        Of the B-spline; by default it has as many free coefficients as the Fourier series.

    Raises
    ------
    ExcitationError
        Unknown name, or numbers out of range.
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
        # six end conditions in place of three: the same number of free coefficients
        return BSpline(2 * harmonics - 1 if intervals is None else intervals, duration)
    raise ExcitationError(f"basis: {name!r}; expected one of {', '.join(NAMES)}")
