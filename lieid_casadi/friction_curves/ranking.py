"""Friction models of the literature fitted to one curve, ranked by BIC."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from lieid_casadi.effects import make
from lieid_casadi.effects.friction_models import FRICTION_MODELS, FrictionModel, friction_model
from lieid_casadi.friction_curves.curve import FrictionCurve
from lieid_casadi.friction_curves.fit_curve import fit_friction
from lieid_casadi.friction_curves.friction_fit import FrictionFit

Progress = Callable[[str, float], None]
# a curve contains neither the offset nor the difference between motoring and generating
STATED = (
    "load_constant", "load_absolute", "load_square", "stribeck", "tustin", "simplified", "eq7",
    "paper", "gao2017", "gao2017_constant_temperature", "he2021", "madsen2020", "panda_sigmoid",
)  # fmt: skip


@dataclass(frozen=True, eq=False)
class RankedFrictionModel:
    """A friction model of the literature and its fit to a curve."""

    model: FrictionModel
    fit: FrictionFit


def rank_friction_models(
    curve: FrictionCurve,
    names: Sequence[str] = STATED,
    *,
    seed: int = 0,
    progress: Progress | None = None,
) -> tuple[RankedFrictionModel, ...]:
    """Fit friction models to a curve and rank them by the Bayesian information criterion (BIC).

    Models that need a temperature are left out if the recordings have none. Differences of the
    BIC below about 6 are not strong evidence (Kass, Raftery, JASA 1995).

    ``names``: names of models in `FRICTION_MODELS`; ``seed``: seed of the random starting points;
    ``progress``: called with the name of a model and the completed fraction (0 to 1).
    Raises `EffectError`: a model with this name does not exist.

    Returns
    -------
    tuple of RankedFrictionModel
        The model with the smallest BIC first.
    """
    models = [friction_model(name) for name in names]
    fitting = [m for m in models if curve.data.has_temperature or not _needs_temperature(m)]
    found = []
    for k, model in enumerate(fitting):
        if progress is not None:
            progress(model.name, k / len(fitting))
        found.append(RankedFrictionModel(model, fit_friction(curve, model.effects, seed=seed)))
    return tuple(sorted(found, key=lambda ranked: ranked.fit.bic))


def _needs_temperature(model: FrictionModel) -> bool:
    return any("temperature" in make(effect).signals for effect in model.effects)


__all__ = ["FRICTION_MODELS", "STATED", "RankedFrictionModel", "rank_friction_models"]
