"""Friction curves of single joints, and friction models fitted to them."""

from lieid_casadi.friction_curves.curve import FrictionCurve, friction_curve
from lieid_casadi.friction_curves.friction_fit import FrictionFit, fit_friction, friction

__all__ = ["FrictionCurve", "FrictionFit", "fit_friction", "friction", "friction_curve"]
