"""Families of trajectories that are linear in their coefficients."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from lieid_casadi.errors import ExcitationError

Array = NDArray[np.float64]
LONGEST = 3600.0  # s, of one period
DEGREE = 5  # of the splines, and of the polynomial of the modified Fourier series


class Basis(Protocol):
    """Functions of time over one duration; column 0 is the constant 1."""

    @property
    def name(self) -> str:
        """Name of the family."""

    @property
    def duration(self) -> float:
        """Length of one period, s."""

    @property
    def size(self) -> int:
        """Number of functions m."""

    def evaluate(self, t: Array) -> Array:
        """Return the functions, their first and second derivatives (3, N, m) at t (N,) in s."""


@dataclass(frozen=True)
class Fourier:
    """Finite Fourier series (Eq. 19); periodic.

    Functions 1, sin(kωt)/(kω) for the coefficients a_k, −cos(kωt)/(kω) for b_k, so that a_k and
    b_k are amplitudes of velocity (rad/s).
    """

    harmonics: int = 5
    duration: float = 20.0
    name = "fourier"

    @property
    def size(self) -> int:
        """Number of functions: 2 H + 1."""
        return 2 * self.harmonics + 1

    def evaluate(self, t: Array) -> Array:
        """Return the functions and two derivatives (3, N, m)."""
        rates = 2.0 * np.pi / self.duration * np.arange(1, self.harmonics + 1)
        angles = np.outer(t, rates)
        sine, cosine = np.sin(angles), np.cos(angles)
        one, zero = np.ones((len(t), 1)), np.zeros((len(t), 1))
        return np.stack(
            [
                np.hstack([one, sine / rates, -cosine / rates]),
                np.hstack([zero, cosine, sine]),
                np.hstack([zero, -sine * rates, cosine * rates]),
            ]
        )


@dataclass(frozen=True)
class ModifiedFourier:
    """Fourier series plus a polynomial of degree 5 that meets the end conditions.

    As in W. Wu, S. Zhu, X. Wang, H. Liu, "Closed-loop dynamic parameter identification of robot
    manipulators using modified Fourier series", IJARS 2012: the end conditions reduce the freedom
    of the polynomial in place of that of the harmonics.
    """

    harmonics: int = 5
    duration: float = 20.0
    name = "modified_fourier"

    @property
    def size(self) -> int:
        """Number of functions: 2 H + 6."""
        return 2 * self.harmonics + 1 + DEGREE

    def evaluate(self, t: Array) -> Array:
        """Return the functions and two derivatives (3, N, m)."""
        series = Fourier(self.harmonics, self.duration).evaluate(t)
        # powers of u ∈ [−1, 1] have the same size
        u, rate = 2.0 * t / self.duration - 1.0, 2.0 / self.duration
        k = np.arange(1, DEGREE + 1)
        powers = u[:, None] ** k
        first = rate * k * u[:, None] ** (k - 1)
        second = rate**2 * k * (k - 1) * u[:, None] ** np.maximum(k - 2, 0)
        return np.concatenate([series, np.stack([powers, first, second])], axis=2)


@dataclass(frozen=True)
class Spline:
    """Uniform quintic B-spline; not periodic, with continuous fourth derivative."""

    intervals: int = 11
    duration: float = 20.0
    name = "spline"

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
        """Return the functions and two derivatives (3, N, m)."""
        from scipy.interpolate import BSpline

        splines = BSpline(self._knots, np.eye(self.intervals + DEGREE), DEGREE)
        values = np.stack([splines(t), splines(t, 1), splines(t, 2)])
        values[:, :, 0] = 0.0
        values[0, :, 0] = 1.0
        return np.asarray(values)


def make(
    family: str = "fourier",
    *,
    duration: float = 20.0,
    harmonics: int = 5,
    intervals: int | None = None,
) -> Basis:
    """Return the basis of a name.

    Parameters
    ----------
    family : str
        ``fourier`` (Eq. 19), ``modified_fourier`` or ``spline``.
    duration : float
        Of one period, s.
    harmonics : int
        Of the Fourier series.
    intervals : int, optional
        Of the spline; by default it has as many free coefficients as the Fourier series.

    Raises
    ------
    ExcitationError
        Unknown family, or numbers out of range.
    """
    if not 0.0 < duration <= LONGEST:
        raise ExcitationError(
            f"duration: {duration:g} s; expected a positive number of at most {LONGEST:g} s"
        )
    if not 2 <= harmonics <= 100:
        raise ExcitationError(f"harmonics: {harmonics}; expected 2 to 100")
    if family == "fourier":
        return Fourier(harmonics, duration)
    if family == "modified_fourier":
        return ModifiedFourier(harmonics, duration)
    if family == "spline":
        # six end conditions in place of three: the same number of free coefficients
        return Spline(2 * harmonics - 1 if intervals is None else intervals, duration)
    raise ExcitationError(f"family: {family!r}; expected fourier, modified_fourier or spline")
