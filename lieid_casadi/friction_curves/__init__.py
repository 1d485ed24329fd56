"""Friction of single joints: curves from both ways of motion, and models fitted to them."""

from lieid_casadi.friction_curves.agreement import FrictionAgreement, compare_friction
from lieid_casadi.friction_curves.curve import FrictionCurve
from lieid_casadi.friction_curves.extraction import friction_curve
from lieid_casadi.friction_curves.fit_curve import fit_friction
from lieid_casadi.friction_curves.friction_fit import FrictionFit
from lieid_casadi.friction_curves.two_stage import TwoStage, together, two_stage

__all__ = [
    "FrictionAgreement",
    "FrictionCurve",
    "FrictionFit",
    "TwoStage",
    "compare_friction",
    "fit_friction",
    "friction_curve",
    "together",
    "two_stage",
]
