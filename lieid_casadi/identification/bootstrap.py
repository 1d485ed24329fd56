"""Block bootstrap: the fit repeated on blocks of the recordings drawn with replacement.

Each block of consecutive instants, several correlation times of the residual long, is reduced to
one triangular factor; a resample stacks factors, so that its cost does not depend on the number
of samples. The only assumption on the residuals is that blocks are exchangeable. It also gives
standard errors of the method ``feasible``, for which there is no formula.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from lieid_casadi.arrays import Array
from lieid_casadi.errors import IdentificationError, NoSolution
from lieid_casadi.identification.feasible.feasible_fit import feasible_problem
from lieid_casadi.identification.feasible.problem import ConvexSolver, FeasibleOptions
from lieid_casadi.identification.fit import Fit
from lieid_casadi.identification.prediction import relative_temperature
from lieid_casadi.identification.regression.design_matrix import Design
from lieid_casadi.identification.regression.fixed_point import Progress
from lieid_casadi.identification.regression.least_squares import (
    Factor,
    combine,
    solve,
)
from lieid_casadi.identification.uncertainty.covariance import residual_correlation_length
from lieid_casadi.model import Model, Parameter
from lieid_casadi.recording import Recording, process
from lieid_casadi.recording.recording import listed

LENGTH = 4  # of a block, in correlation times of the residuals
FEWEST_BLOCKS = 10
MOST_BLOCKS = 60  # more only make a resample slower


@dataclass(frozen=True, eq=False)
class Bootstrap:
    """Repeated fits.

    Attributes
    ----------
    model : Model
    values : (B, p)
        Base values of each resample.
    block_count : int
        Number of blocks that resamples are drawn from.
    block_seconds : float
        Length of a block, s.
    failed : int
        Number of resamples without a solution (method ``feasible``); they are left out.
    """

    model: Model
    values: Array
    block_count: int
    block_seconds: float
    failed: int = 0

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """Parameters that the columns of ``values`` belong to."""
        return self.model.base_columns

    @property
    def covariance(self) -> Array:
        """Of the base values (p, p)."""
        return np.atleast_2d(np.cov(self.values, rowvar=False))

    @property
    def std(self) -> Array:
        """Standard deviations of the base values (p,)."""
        return np.asarray(self.values.std(axis=0, ddof=1))

    def __repr__(self) -> str:
        return (
            f"<Bootstrap: {len(self.values)} resamples of {self.block_count} blocks of "
            f"{self.block_seconds:.3g} s>"
        )

    def interval(self, level: float = 0.95) -> tuple[Array, Array]:
        """Return lower and upper bounds (p,) of the central ``level`` of the resamples."""
        tail = 0.5 * (1.0 - level)
        low, high = np.quantile(self.values, [tail, 1.0 - tail], axis=0)
        return low, high


def bootstrap(
    fit: Fit,
    recordings: Recording | Sequence[Recording],
    *,
    resamples: int = 200,
    seed: int = 0,
    feasible: FeasibleOptions | None = None,
    progress: Progress | None = None,
) -> Bootstrap:
    """Repeat a fit on resampled blocks of its recordings.

    The block bootstrap of Künsch (Annals of Statistics 17(3), 1989), with blocks that do not
    overlap. Weights and shape parameters are those of the fit.

    Parameters
    ----------
    fit : Fit
    recordings : Recording or sequence of Recording
        Training recordings of the fit.
    resamples : int
        Number B of repeated fits.
    seed : int
        Of the random numbers.
    feasible : FeasibleOptions, optional
        As given to `identify`; the regularization is that of the fit.
    progress : callable, optional
        Called with a stage's name and the fraction done.

    Returns
    -------
    Bootstrap

    Raises
    ------
    IdentificationError
        Too few blocks in the recordings, or fewer than two resamples.
    """
    if resamples < 2:
        raise IdentificationError(f"{resamples} resamples, expected at least 2")
    segments = [
        relative_temperature(segment, fit.temperature_mean)
        for segment in process(listed(recordings), fit.processing)
    ]
    design = Design(fit.compiled, segments)
    rows = design.rows(fit.shapes, fit.parameters)
    weights = np.ones(fit.model.n) if fit.method == "ols" else 1.0 / fit.noise
    correlated = residual_correlation_length(rows, rows.residuals(fit.values))
    length = max(LENGTH * correlated, int(rows.segments[-1]) // MOST_BLOCKS)
    numbers = rows.blocks(length)
    parts = [rows.factors_at(numbers == k) for k in range(int(numbers.max()) + 1)]
    blocks = [block for part in parts if (block := combine(part, weights)).rows]
    step = float(np.median(np.diff(segments[0].filtered_time)))
    if len(blocks) < FEWEST_BLOCKS:
        raise IdentificationError(
            f"{len(blocks)} blocks of {length * step:.3g} s, the length over which residuals are "
            "correlated; "
            f"expected at least {FEWEST_BLOCKS}: give longer recordings"
        )
    estimate = _estimator(fit, design, blocks, feasible)
    random, found, failed = np.random.default_rng(seed), [], 0
    for k in range(resamples):
        drawn = random.integers(len(blocks), size=len(blocks))
        try:
            found.append(estimate(combine([blocks[i] for i in drawn], np.ones(len(drawn)))))
        except NoSolution:
            failed += 1
        if progress is not None:
            progress("bootstrap", (k + 1) / resamples)
    if len(found) < 2:
        raise NoSolution("no resample has physically consistent parameters; use method wls")
    return Bootstrap(fit.model, np.array(found), len(blocks), length * step, failed)


def _estimator(
    fit: Fit, design: Design, blocks: Sequence[Factor], options: FeasibleOptions | None
) -> Callable[[Factor], Array]:
    if fit.certificate is None:
        return lambda factor: solve(factor).values
    weight = fit.certificate.regularization
    whole = combine(blocks, np.ones(len(blocks)))
    problem, _ = feasible_problem(
        design, whole, fit.shapes, fit.parameters, options or FeasibleOptions()
    )
    solver = ConvexSolver(problem)
    return partial(solver.base_values, weight=weight)
