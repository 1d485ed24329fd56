"""Friction of single joints: curves from both ways of motion, and models fitted to them."""

from lieid_casadi.friction.curve import FrictionCurve
from lieid_casadi.friction.extract import friction_curve
from lieid_casadi.friction.fit_curve import fit_friction
from lieid_casadi.friction.result import FrictionFit

__all__ = ["FrictionCurve", "FrictionFit", "fit_friction", "friction_curve"]
