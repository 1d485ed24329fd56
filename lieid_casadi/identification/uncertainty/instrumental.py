"""Instrumental variables: base parameters without bias from noise in the measured motion.

Noise in q̇ and q̈ enters the columns of the regression and biases least squares towards zero, for
recordings of any length and without effect on the covariance. Instruments are the same columns on
a motion without that noise: β = (ZᵀX)⁻¹Zᵀτ (Janot, Vandanjon, Gautier, "A generic instrumental
variable approach for industrial robot identification", IEEE TCST 2014, where the motion is that
of the simulated arm).

A Durbin-Wu-Hausman test, revised as by the same authors (Control Engineering Practice 2016),
shows whether instruments are needed: the part V of the columns that the instruments do not
explain, projected off the columns, is tested for correlation with the residual, with the
correlation of the residual in time accounted for. Negligible directions of V are not tested.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2

from lieid_casadi.compiled.triangular_factors import triangular
from lieid_casadi.errors import IdentificationError, ModelError
from lieid_casadi.identification.regression.design_matrix import Design
from lieid_casadi.identification.regression.least_squares import (
    RANK_TOLERANCE,
    Factor,
    LeastSquaresSolution,
    solve,
)
from lieid_casadi.identification.regression.rows import JointRows, Rows
from lieid_casadi.identification.temperature import relative_temperature
from lieid_casadi.identification.uncertainty.covariance import hac_covariance
from lieid_casadi.recording import Processed, Recording, process
from lieid_casadi.recording.filtering import central_difference, lowpass, smooth_at
from lieid_casadi.recording.recording import listed
from lieid_casadi.recording.spectrum import motion_band

if TYPE_CHECKING:
    from lieid_casadi.identification.fit import Fit

Array = NDArray[np.float64]
BAND = 3.0  # cut-off of the instruments' motion, in bandwidths of the recorded motion
PART = 0.25  # largest such cut-off, in cut-offs of the fit: noise can widen the estimated band
NEGLIGIBLE = 1e-3  # of a column's norm: the bias from less noise is negligible
DIRECTIONS = 10  # of V, the strongest, that are tested
SIGNIFICANCE = 0.01


@dataclass(frozen=True)
class ExogeneityTest:
    """Null hypothesis: noise in the columns is not correlated with the residual.

    Attributes
    ----------
    noise : float
        Largest part of a column that the instruments do not explain, relative to the column.
    statistic : float
        Wald statistic, χ² with ``directions`` degrees of freedom under the null hypothesis.
    directions : int
        0 if the noise is negligible; nothing is tested then.
    p_value : float
    """

    noise: float
    statistic: float
    directions: int
    p_value: float

    @property
    def biased(self) -> bool:
        """Whether least squares is biased by noise in the motion, at the 1 % level."""
        return self.p_value < SIGNIFICANCE


@dataclass(frozen=True, eq=False)
class Instrumental:
    """Instrumental-variable estimate for comparison with a least-squares fit.

    Attributes
    ----------
    fit : Fit
        With the instrumental values, method ``iv``.
    bias : (p,)
        Least squares minus instrumental values.
    test : ExogeneityTest
    """

    fit: Fit
    bias: Array
    test: ExogeneityTest


def instrumental(
    fit: Fit,
    recordings: Recording | Sequence[Recording],
    *,
    reference: Recording | Sequence[Recording] | None = None,
) -> Instrumental:
    """Estimate the base values of a fit with instruments, and test whether they are needed.

    Weights and shape parameters are those of the fit.

    Parameters
    ----------
    fit : Fit
        By least squares.
    recordings : Recording or sequence of Recording
        Training recordings of the fit.
    reference : Recording or sequence of Recording, optional
        One per recording: the commanded motion with q, dq and ddq, on the same clock. Without
        it, the recorded motion is low-passed at three times its bandwidth, which removes nearly
        all noise in q̈ and most of that in q.

    Raises
    ------
    IdentificationError
        A fit of method ``feasible``, or instruments that do not determine the parameters.
    ModelError
        References that do not match the recordings.
    """
    if fit.method == "feasible":
        raise IdentificationError(
            "instruments need a fit by least squares; expected method wls, ols or robust"
        )
    given, commanded = listed(recordings), None if reference is None else listed(reference)
    if commanded is not None and len(commanded) != len(given):
        raise ModelError(
            f"{len(commanded)} reference motions for {len(given)} recordings; expected one each"
        )
    measured, smooth = [], []
    for k, recording in enumerate(given):
        for segment in process(recording, fit.processing):
            own = relative_temperature(segment, fit.temperature_mean)
            # the smoothed sign of a noisy velocity is biased, and instruments do not correct it
            own = replace(own, dead_zone=np.zeros(own.n))
            measured.append(own)
            smooth.append(_band_limited(own) if commanded is None else _along(own, commanded[k]))
    rows, columns = (
        Design(fit.compiled, of).rows(fit.shapes, fit.parameters) for of in (measured, smooth)
    )
    weights = np.ones(fit.model.n) if fit.method == "ols" else 1.0 / fit.noise
    regression = _InstrumentalRows(rows, columns, weights)
    solution = regression.solution()
    p = len(solution.values)
    covariance = fit.covariance.copy()
    covariance[:p, :p] = regression.covariance(solution)
    changed = replace(
        fit,
        method="iv",
        values=solution.values,
        parameters=fit.model.base.lift(solution.values, fit.parameters),
        covariance=covariance,
    )
    return Instrumental(changed, fit.values - solution.values, regression.test())


def _band_limited(segment: Processed) -> Processed:
    """Return a segment with its motion low-passed at a few times its bandwidth."""
    band = motion_band(segment.recording)
    if band is None:
        raise IdentificationError(
            "no joint moves in the recording; expected a recording of a motion"
        )
    q = lowpass(segment.q, segment.rate, min(BAND * band, PART * segment.cutoff))
    dq = central_difference(q, segment.rate)
    return replace(segment, q=q, dq=dq, ddq=central_difference(dq, segment.rate))


def _along(segment: Processed, reference: Recording) -> Processed:
    """Return a segment with the motion of a reference recording at its instants."""
    t, name = segment.t, reference.name or "reference"
    if reference.n != segment.n:
        raise ModelError(f"{name}: {reference.n} joints, expected {segment.n}")
    slack = 1.0 / reference.rate
    if reference.t[0] > t[0] + slack or reference.t[-1] < t[-1] - slack:
        raise ModelError(
            f"{name}: {reference.t[0]:g} to {reference.t[-1]:g} s, expected all of "
            f"{t[0]:g} to {t[-1]:g} s, on the recording's clock"
        )
    q = smooth_at(reference.t, reference.q, np.clip(t, reference.t[0], reference.t[-1]))
    dq = _at(reference, reference.dq, t)
    dq = central_difference(q, segment.rate) if dq is None else dq
    ddq = _at(reference, reference.ddq, t)
    ddq = central_difference(dq, segment.rate) if ddq is None else ddq
    return replace(segment, q=q, dq=dq, ddq=ddq)


def _at(reference: Recording, values: Array | None, t: Array) -> Array | None:
    if values is None:
        return None
    return smooth_at(reference.t, values, np.clip(t, reference.t[0], reference.t[-1]))


class _InstrumentalRows:
    """Weighted rows of all joints: measured columns X, instruments Z, and torque.

    Attributes
    ----------
    x, explained : (R, p)
        Columns, and the part of them that the instruments explain: Z·Z⁺·X.
    torque : (R,)
    """

    def __init__(self, rows: Rows, instruments: Rows, weights: Array) -> None:
        self.rows, self.weights = rows, weights
        self.x, z = (_dense(of, weights) for of in (rows, instruments))
        joints = zip(rows.joints, weights, strict=True)
        self.torque = np.concatenate([joint.torque * w for joint, w in joints])
        size = np.linalg.norm(z, axis=0)
        size[size == 0.0] = 1.0
        self.explained = z / size @ np.linalg.lstsq(z / size, self.x, rcond=1e-10)[0]

    def solution(self) -> LeastSquaresSolution:
        """Return the instrumental values, with (X̂ᵀX̂)⁻¹."""
        small = triangular(np.column_stack([self.explained, self.torque]))
        return solve(Factor(small, len(self.torque)))

    def covariance(self, solution: LeastSquaresSolution) -> Array:
        """Return the covariance of the instrumental values (p, p)."""
        explained = self._rows(self.explained)
        ones = [np.ones(len(joint.torque)) for joint in explained.joints]
        residual = self._parts(self.torque - self.x @ solution.values)
        return hac_covariance(explained, ones, residual, solution.unit_covariance)

    def test(self) -> ExogeneityTest:
        """Return the test of least squares."""
        size = np.linalg.norm(self.x, axis=0)
        size[size == 0.0] = 1.0
        noise = (self.x - self.explained) / size
        largest = float(np.linalg.norm(noise, axis=0).max(initial=0.0))
        basis = np.linalg.svd(self.x / size, full_matrices=False)
        basis_used = basis[0][:, basis[1] > RANK_TOLERANCE * basis[1][0]]
        projected = noise - basis_used @ (basis_used.T @ noise)
        directions, sizes, _ = np.linalg.svd(projected, full_matrices=False)
        count = min(int(np.sum(sizes > NEGLIGIBLE)), DIRECTIONS)
        if count == 0:
            return ExogeneityTest(largest, 0.0, 0, 1.0)
        directions = directions[:, :count]
        residual = self.torque - basis_used @ (basis_used.T @ self.torque)
        found = directions.T @ residual
        ones = [np.ones(len(joint.torque)) for joint in self.rows.joints]
        spread = hac_covariance(self._rows(directions), ones, self._parts(residual), np.eye(count))
        statistic = float(found @ np.linalg.solve(spread, found))
        return ExogeneityTest(largest, statistic, count, float(chi2.sf(statistic, count)))

    def _rows(self, matrix: Array) -> Rows:
        columns = np.arange(matrix.shape[1])
        joints = [
            JointRows(columns, own, joint.torque, joint.instant)
            for own, joint in zip(self._parts(matrix), self.rows.joints, strict=True)
        ]
        return Rows(joints, matrix.shape[1], self.rows.segments)

    def _parts(self, stacked: Array) -> list[Array]:
        return list(np.split(stacked, np.cumsum(self.rows.lengths)[:-1]))


def _dense(rows: Rows, weights: Array) -> Array:
    parts = []
    for joint, weight in zip(rows.joints, weights, strict=True):
        wide = np.zeros((len(joint.torque), rows.count))
        wide[:, joint.columns] = joint.matrix * weight
        parts.append(wide)
    return np.concatenate(parts)
