"""How sure: family-wise p-values over everything that was tried."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2

from lieid_casadi.diagnosis.screening import Screening

Array = NDArray[np.float64]
DRAWS = 200


@dataclass(frozen=True)
class Family:
    """All candidates and grid points as one family of tests under white noise.

    ``tests`` is the number of independent tests whose smallest p-value is distributed like that
    of the family (parametric bootstrap of the maximum statistic).
    """

    tests: float

    @classmethod
    def of(cls, screening: Screening, *, seed: int) -> Family:
        """Draw white rows and screen them: nothing is there to be found."""
        random = np.random.default_rng([seed, 61])
        rank = np.maximum(screening.rank, 1)
        smallest = []
        for _ in range(0, DRAWS, 50):
            noise = random.standard_normal((screening.baseline.rows, 50))
            p = chi2.sf(screening.statistic(noise), rank[:, None])
            smallest.append(p.min(axis=0, initial=1.0))
        # the least of N uniform numbers has −ln(1 − p) exponential with mean 1/N
        return cls(max(1.0, 1.0 / float(np.mean(-np.log1p(-np.concatenate(smallest))))))

    def log10_p(self, gain: float, rank: int) -> float:
        """Return log₁₀ of the family-wise p-value of a gain: all tests count."""
        log_p = float(chi2.logsf(gain, max(rank, 1)))
        if log_p < -30.0:
            return (log_p + np.log(self.tests)) / np.log(10.0)
        return float(np.log10(max(-np.expm1(self.tests * np.log1p(-np.exp(log_p))), 1e-300)))
