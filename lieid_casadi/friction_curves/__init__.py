"""Friction curves of single joints, friction models fitted to them, identification in stages."""

from lieid_casadi.friction_curves.curve import FrictionCurve, friction_curve
from lieid_casadi.friction_curves.friction_fit import (
    FrictionFit,
    RankedFrictionModel,
    fit_friction,
    friction,
    rank_friction_models,
)
from lieid_casadi.friction_curves.stages import StagedFit, combine_stages, identify_in_stages

__all__ = [
    "FrictionCurve",
    "FrictionFit",
    "RankedFrictionModel",
    "StagedFit",
    "combine_stages",
    "fit_friction",
    "friction",
    "friction_curve",
    "identify_in_stages",
    "rank_friction_models",
]
