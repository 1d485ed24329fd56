"""The noise of a fit's residual, estimated after a generous selection of effects."""

from __future__ import annotations

from lieid_casadi.diagnosis.screening.baseline import with_groups
from lieid_casadi.diagnosis.screening.context import ScreeningContext
from lieid_casadi.diagnosis.search.forward_selection import best_set
from lieid_casadi.identification.uncertainty.noise_model import Noise, noise_of


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
    groups = best_set(candidates, baseline, options.pilot_penalty, options)
    rich = with_groups(baseline, candidates, groups)
    smooth = context.smooth.whitened(white, context.runs)
    groups = best_set(smooth, rich, options.pilot_smooth_penalty, options)
    rich = with_groups(rich, smooth, groups)
    freedom = 1.0 - rich.rank / max(rich.rows, 1)
    coloured = []
    for j, (noise, runs) in enumerate(zip(white, context.runs, strict=True)):
        residual = rich.residual[rich.joint(j)] * noise.sigma / runs.weights(noise.spread)
        coloured.append(noise_of(residual, runs, freedom))
    return tuple(coloured), tuple(Noise.white(noise.spread) for noise in coloured)
