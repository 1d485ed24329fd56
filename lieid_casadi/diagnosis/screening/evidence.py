"""Family-wise p-values over all candidates that were screened."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtrc, gammaln
from scipy.stats import chi2

from lieid_casadi.diagnosis.screening.screen import Screening

Array = NDArray[np.float64]
DRAWS_AT_ONCE = 50


@dataclass(frozen=True)
class HypothesisFamily:
    """All candidates and grid points as one family of tests; the null hypothesis is white noise.

    Attributes
    ----------
    tests : float
        Number of independent tests whose smallest p-value has the same distribution as the
        smallest of the family (parametric bootstrap of the largest statistic).
    """

    tests: float

    @classmethod
    def of(
        cls, screening: Screening, *, seed: int, draws: int, further: int = 0
    ) -> HypothesisFamily:
        """Estimate the number of independent tests by screening white noise.

        Parameters
        ----------
        screening : Screening
        seed : int
            Of the draws.
        draws : int
            Number of draws of white rows, rounded up to multiples of 50.
        further : int
            Tests made in addition to those that are screened.
        """
        random = np.random.default_rng([seed, 61])
        rank = np.maximum(screening.rank, 1)
        ranks, smallest = np.unique(rank), []
        for _ in range(0, draws, DRAWS_AT_ONCE):
            noise = random.standard_normal((screening.baseline.rows, DRAWS_AT_ONCE))
            statistic = screening.statistic(noise)
            largest = [statistic[rank == k].max(axis=0) for k in ranks]
            p = [np.asarray(chi2.sf(x, k)) for x, k in zip(largest, ranks, strict=True)]
            smallest.append(np.min(p, axis=0, initial=1.0))
        # the least of N uniform numbers has −ln(1 − p) exponential with mean 1/N
        exponential = -np.log1p(-np.minimum(np.concatenate(smallest), 1.0 - 1e-12))
        return cls(max(1.0, 1.0 / float(np.mean(exponential))) + further)

    def log10_p(self, gain: float, rank: int) -> float:
        """Return log₁₀ of the family-wise p-value of a gain with ``rank`` degrees of freedom."""
        half, rank = 0.5 * gain, max(rank, 1)
        with np.errstate(divide="ignore"):
            log_p = float(np.log(chdtrc(rank, max(gain, 0.0))))
        if not np.isfinite(log_p):  # underflow in the far tail
            log_p = (0.5 * rank - 1.0) * np.log(half) - half - float(gammaln(0.5 * rank))
        if log_p < -30.0:
            return float((log_p + np.log(self.tests)) / np.log(10.0))
        p = min(float(np.exp(log_p)), 1.0 - 1e-12)
        return float(np.log10(max(-np.expm1(self.tests * np.log1p(-p)), 1e-300)))
