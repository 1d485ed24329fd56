"""Condition number of the stacked full regressor, independent of the choice of base."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from lieid_casadi.dynamics.base_parameters import BaseParameters
from lieid_casadi.identification.regression.least_squares import Factor


@dataclass(frozen=True)
class Conditioning:
    """Singular values of the stacked full regressor [Y, effect columns] (SI, unscaled).

    ``condition_number`` is σ₁/σ_r with r the structural rank; ``beyond`` is σ_{r+1}, zero up
    to rounding errors.
    """

    largest: float
    smallest: float
    beyond: float

    @property
    def condition_number(self) -> float:
        """σ₁/σ_r, infinite if the recording does not excite a structural direction."""
        return self.largest / self.smallest if self.smallest > 0.0 else float("inf")


def conditioning(unweighted: Factor, base: BaseParameters) -> Conditioning:
    """Return the conditioning of the full regressor, which is base columns · combination.

    Parameters
    ----------
    unweighted : Factor
        Of the base columns.
    base : BaseParameters
    """
    full = unweighted.r[:, :-1] @ base.combination
    sizes = np.linalg.svd(full, compute_uv=False)
    rank = base.count
    beyond = float(sizes[rank]) if len(sizes) > rank else 0.0
    smallest = float(sizes[rank - 1]) if len(sizes) >= rank else 0.0
    return Conditioning(float(sizes[0]), smallest, beyond)
