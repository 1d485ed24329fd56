"""Ensembles: probabilities of rival models, and how much of a held-out torque draws contain."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.special import softmax
from scipy.stats import norm

from lieid_casadi.arrays import Array
from lieid_casadi.errors import IdentificationError
from lieid_casadi.identification.fit import Fit
from lieid_casadi.identification.uncertainty.noise_model import redundancy_of, row_step
from lieid_casadi.messages import joints_text
from lieid_casadi.recording import Recording, process
from lieid_casadi.recording.recording import listed

BLOCK = 2.0  # s, longer than the correlation of residuals
RESAMPLES = 2000
FEWEST_BLOCKS = 5
TOLERATED = 0.1  # of the level, by which the share may be smaller


def model_weights(
    fits: Sequence[Fit], recordings: Recording | Sequence[Recording], *, seed: int = 0
) -> Array:
    """Return the probabilities (m,) of models of one arm by their errors on held-out recordings.

    Pseudo-Bayesian model averaging with the Bayesian bootstrap (Yao, Vehtari, Simpson, Gelman,
    Bayesian Analysis 2018): each block of 2 s has the likelihood of normal residuals, whose number
    is that of the independent ones; the blocks are weighted at random, so that models which a few
    blocks alone separate keep similar weights. Rows at rest do not count. None of the fits was
    trained on the recordings; an `IdentificationError` refuses less than five blocks of motion.
    """
    squares, counts = _block_squares(fits, recordings)
    if counts.shape[0] < FEWEST_BLOCKS:
        raise IdentificationError(
            f"{counts.shape[0]} blocks of {BLOCK:g} s with motion; expected at least "
            f"{FEWEST_BLOCKS} to weight models: give longer recordings"
        )
    redundancy = np.array([redundancy_of(noise) for noise in fits[0].residual_noise])
    size = np.min(squares.sum(axis=1), axis=0) / np.maximum(counts.sum(axis=0), 1e-300)
    relative = squares / np.where(size > 0.0, size, np.inf) / redundancy
    likelihood = -0.5 * relative.sum(axis=2)  # (m, blocks)
    blocks = likelihood.shape[1]
    drawn = np.random.default_rng(seed).dirichlet(np.ones(blocks), RESAMPLES) * blocks
    return np.asarray(softmax(drawn @ likelihood.T, axis=1).mean(axis=0))


def _block_squares(
    fits: Sequence[Fit], recordings: Recording | Sequence[Recording]
) -> tuple[Array, Array]:
    """Return sums of squared errors (m, blocks, n) of rows in motion, and their numbers.

    Rows are those at twice the cut-off, the rate of independent residuals under white noise.
    """
    squares, counts = [], []
    for segment in process(listed(recordings), fits[0].processing):
        assert segment.tau is not None  # checked by the caller's fits
        step, measured = row_step(segment), segment.filter(segment.tau)
        moving = segment.filtered_moving[::step]
        errors = [(measured - fit.predict_processed(segment))[::step] for fit in fits]
        block = ((segment.filtered_time - segment.filtered_time[0]) // BLOCK).astype(int)[::step]
        for k in range(int(block.max(initial=-1)) + 1):
            use = moving & (block == k)[:, None]
            if use.any():
                squares.append([np.sum(np.where(use, e, 0.0) ** 2, axis=0) for e in errors])
                counts.append(use.sum(axis=0))
    if not squares:
        raise IdentificationError("no joint moves in the recordings; models cannot be weighted")
    return np.swapaxes(np.array(squares), 0, 1), np.array(counts, dtype=float)


@dataclass(frozen=True, eq=False)
class EnsembleCoverage:
    """How much of the measured torque of recordings the bands of an ensemble contain.

    Bands are the mean ± the normal quantile, by the variance of the draws and that of the residual
    of the training, but no less than its held-out error.
    """

    level: float  # probability that the bands are made for
    share: Array  # (n,): of the rows in motion that they contain, NaN for a joint that never moves
    spread: Array  # (n,): standard deviation of the draws' torque, N·m: of the parameters alone
    error: Array  # (n,): RMS error of the mean of the draws, N·m

    @property
    def too_narrow(self) -> Array:
        """Mark the joints (n,) on which errors of the model exceed what the bands state."""
        return np.asarray(self.share < self.level - TOLERATED)

    @property
    def sentence(self) -> str:
        """The result in one or two sentences."""
        low, high = np.nanmin(self.share), np.nanmax(self.share)
        text = (
            f"{100 * self.level:.0f} % bands of the samples and the residual contain "
            f"{100 * low:.0f} to {100 * high:.0f} % of the measured torque in motion."
        )
        if not self.too_narrow.any():
            return text
        worst = np.nanmax(np.where(self.too_narrow, self.error / self.spread, np.nan))
        return (
            f"{text} On {joints_text(self.too_narrow)} errors of the model dominate (up to "
            f"{worst:.0f} times the scatter of the samples): find what it lacks (lieid diagnose), "
            "or randomise the torque as well."
        )

    def to_dict(self) -> dict[str, Any]:
        """Return plain data for JSON."""
        arrays = {"share": self.share, "spread": self.spread, "error": self.error}
        numbers = {k: [None if np.isnan(v) else float(v) for v in x] for k, x in arrays.items()}
        return {"level": self.level, **numbers, "sentence": self.sentence}


def ensemble_coverage(
    samples: Sequence[Fit], recordings: Recording | Sequence[Recording], *, level: float = 0.9
) -> EnsembleCoverage:
    """Return how much of the torque of recordings the bands of samples (`Fit.sample`) contain.

    The recordings were not used for training; ``level`` is a probability.
    """
    quantile = norm.ppf(0.5 + 0.5 * level)
    inside, variances, errors, moves = [], [], [], []
    for segment in process(listed(recordings), samples[0].processing):
        assert segment.tau is not None  # checked when recordings are read
        torque = np.array([sample.predict_processed(segment) for sample in samples])
        residual, held_out = (
            np.mean([getattr(s, name) ** 2 for s in samples], axis=0)
            for name in ("noise", "rms_cv")
        )
        variances.append(torque.var(axis=0))
        errors.append(segment.filter(segment.tau) - torque.mean(axis=0))
        width = np.sqrt(np.fmax(variances[-1] + residual, held_out))
        inside.append(np.abs(errors[-1]) <= quantile * width)
        moves.append(segment.filtered_moving)
    moving = np.where(np.concatenate(moves), 1.0, np.nan)
    with np.errstate(invalid="ignore"):
        share, variance, square = (
            np.nansum(np.concatenate(x) * moving, axis=0) / np.nansum(moving, axis=0)
            for x in (inside, variances, [e**2 for e in errors])
        )
    return EnsembleCoverage(level, share, np.sqrt(variance), np.sqrt(square))
