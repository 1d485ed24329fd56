"""The successive fits of the accepted effects, computed again after effects were removed."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from lieid_casadi.diagnosis.search.search_results import AcceptedEffect, with_fit
from lieid_casadi.identification import Fit
from lieid_casadi.identification.regression.fixed_point import ShapeStart
from lieid_casadi.model import Model

Array = NDArray[np.float64]


class Refit(Protocol):
    """Fit of a model to the training recordings, from shape parameters."""

    def __call__(self, larger: Model, start: ShapeStart, *, uncertainty: bool = False) -> Fit:
        """Return the fit, as `identify_segments`.

        Parameters
        ----------
        larger : Model
        start : ShapeStart
        uncertainty : bool
            Whether the covariance is computed; no step of a search needs it.
        """


def start_near(fit: Fit, model: Model, shapes: Array, *, held: bool = False) -> ShapeStart:
    """Return the start of a fit of another model: links and coefficients of effects in both.

    Parameters
    ----------
    fit : Fit
    model : Model
        Of the same robot.
    shapes : (s,)
        Shape parameters of the model.
    held : bool
        Whether they stay fixed.
    """
    known = {
        column.label: float(value)
        for column, value in zip(fit.model.columns, fit.effect_coefficients, strict=True)
    }
    coefficients = [known.get(column.label, 0.0) for column in model.columns]
    parameters = np.concatenate([fit.link_parameters, coefficients])
    return ShapeStart(shapes, held=held, parameters=parameters)


def fitted_again(
    kept: Sequence[AcceptedEffect],
    order: Sequence[Fit | None],
    changed: Collection[Fit | None],
    shapes: Mapping[str, float],
    *,
    first: Fit,
    refit: Refit,
) -> tuple[list[AcceptedEffect], Fit]:
    """Return effects with new fits from the first changed one on, and the last fit.

    Effects that were added at once have one fit. The last fit is always computed again, with the
    given shape parameters.

    Parameters
    ----------
    kept : sequence of AcceptedEffect
        In the order added.
    order : sequence of Fit
        Successive fits before effects were removed or exchanged.
    changed : collection of Fit
        Of the effects that were removed or exchanged.
    shapes : mapping
        Shape parameters by label, which are held.
    first : Fit
        Of the model without any of the effects.
    refit : callable
    """
    families = {fit: [a for a in kept if a.fit is fit] for fit in order}
    last = next((fit for fit in reversed(order) if families[fit]), None)
    effects: list[AcceptedEffect] = []
    fit, again = first, False
    for before, family in families.items():
        again = again or before in changed
        if not family:
            continue
        if again or before is last or before is None:
            placements = [effect.candidate.placement for effect in family]
            model = Model.of_placements(fit.model.robot, (*fit.model.placements, *placements))
            held = np.array([shapes[p.label] for p in model.shapes])
            fit = refit(model, start_near(fit, model, held, held=True))
        else:
            fit = before
        effects += [with_fit(effect, fit) for effect in family]
    return effects, fit
