"""Friction of single joints: curves from both ways of motion, and models fitted to them."""

from lieid_casadi.friction.agreement import FrictionAgreement, compare_friction
from lieid_casadi.friction.curve import FrictionCurve
from lieid_casadi.friction.extract import friction_curve
from lieid_casadi.friction.fit_curve import fit_friction
from lieid_casadi.friction.result import FrictionFit
from lieid_casadi.friction.stages import TwoStage, together, two_stage

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
