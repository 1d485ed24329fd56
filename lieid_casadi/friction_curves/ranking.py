"""Friction models of the literature on one curve, the most credible first."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from lieid_casadi.effects import make
from lieid_casadi.effects.friction_models import FRICTION_MODELS, FrictionModel, friction_model
from lieid_casadi.friction_curves.curve import FrictionCurve
from lieid_casadi.friction_curves.fit_curve import fit_friction
from lieid_casadi.friction_curves.friction_fit import FrictionFit

Progress = Callable[[str, float], None]
# a curve has no offset, and both ways together cannot tell motoring from generating
STATED = (
    "load_constant", "load_absolute", "load_square", "stribeck", "tustin", "simplified", "eq7",
    "paper", "gao2017", "gao2017_constant_temperature", "he2021", "madsen2020", "panda_sigmoid",
)  # fmt: skip


@dataclass(frozen=True, eq=False)
class Candidate:
    """A friction model of the literature and its fit to a curve."""

    model: FrictionModel
    fit: FrictionFit


def rank_friction_models(
    curve: FrictionCurve,
    names: Sequence[str] = STATED,
    *,
    seed: int = 0,
    progress: Progress | None = None,
) -> tuple[Candidate, ...]:
    """Fit friction models to a curve and return them by Schwarz's criterion, best first.

    Models that need a temperature are left out where the recordings have none. A lower
    criterion is told from a higher one by about 6 or more (Kass, Raftery, JASA 1995).

    Parameters
    ----------
    curve : FrictionCurve
    names : sequence of str
        Of `FRICTION_MODELS`.
    seed : int
        Of the drawn starts.
    progress : callable, optional
        Called with a model's name and the fraction done.

    Raises
    ------
    EffectError
        No such model.
    """
    models = [friction_model(name) for name in names]
    fitting = [m for m in models if curve.data.has_temperature or not _needs_temperature(m)]
    found = []
    for k, model in enumerate(fitting):
        if progress is not None:
            progress(model.name, k / len(fitting))
        found.append(Candidate(model, fit_friction(curve, model.effects, seed=seed)))
    return tuple(sorted(found, key=lambda candidate: candidate.fit.bic))


def _needs_temperature(model: FrictionModel) -> bool:
    return any("temperature" in make(effect).signals for effect in model.effects)


__all__ = ["FRICTION_MODELS", "STATED", "Candidate", "rank_friction_models"]
