"""The noise of a fit's residual, estimated after a generous selection of effects."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from lieid_casadi.diagnosis.screening.baseline import Baseline
from lieid_casadi.diagnosis.screening.context import ScreeningContext
from lieid_casadi.diagnosis.screening.screen import SelectionState
from lieid_casadi.diagnosis.search.forward_selection import best_set
from lieid_casadi.identification.uncertainty.noise_model import Noise, noise_of

Array = NDArray[np.float64]


def pilot_noise(context: ScreeningContext) -> tuple[tuple[Noise, ...], tuple[Noise, ...]]:
    """Estimate the noise of each joint from the residual of a generous first selection.

    The residual of the fit itself contains the missing effects, whose correlation in time would
    be attributed to the noise.

    Returns
    -------
    coloured : tuple of Noise
        Autoregressive, one per joint.
    white : tuple of Noise
        Of the same standard deviation.
    """
    options, white = context.options, context.white_noise
    candidates, baseline = context.candidates.whitened(white, context.runs), context.baseline(white)
    state = SelectionState(candidates, baseline, options)
    groups = best_set(state, options.pilot_penalty, options)
    coloured = _noise_of(context, white, state.with_groups(groups))
    return coloured, tuple(Noise.white(noise.spread) for noise in coloured)


def final_noise(
    context: ScreeningContext, further: Sequence[Array] | None = None
) -> tuple[Noise, ...]:
    """Estimate the autoregressive noise of each joint from the residual of the last model.

    The pilot noise allows for unexplained torque that is large relative to the first model's
    residual only; after effects were added, smaller ones would be attributed to the noise.

    Parameters
    ----------
    context : ScreeningContext
    further : sequence of (N_j, k), optional
        Columns of each joint, not whitened, that are not attributed to the noise either.
    """
    white = context.white_noise
    baseline = context.baseline(white)
    if further is not None:
        baseline = baseline.with_columns(np.concatenate(context.whitened(white, further)))
    return _noise_of(context, white, baseline)


def _noise_of(
    context: ScreeningContext, white: tuple[Noise, ...], rich: Baseline
) -> tuple[Noise, ...]:
    """Return the noise (one per joint) of a residual from which smooth functions are removed."""
    smooth = context.smooth.whitened(white, context.runs)
    options = context.options
    state = SelectionState(smooth, rich, options)
    rich = state.with_groups(best_set(state, options.pilot_smooth_penalty, options))
    freedom = 1.0 - rich.rank / max(rich.rows, 1)
    coloured = []
    for j, (noise, runs) in enumerate(zip(white, context.runs, strict=True)):
        residual = rich.residual[rich.joint(j)] * noise.sigma / runs.weights(noise.spread)
        coloured.append(noise_of(residual, runs, freedom))
    return tuple(coloured)
