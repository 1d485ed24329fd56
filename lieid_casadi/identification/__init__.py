"""Identification: fits of a model's parameters to recordings."""

from lieid_casadi.identification.feasible.certificate import Certificate
from lieid_casadi.identification.fit import Fit
from lieid_casadi.identification.identify import identify

__all__ = ["Certificate", "Fit", "identify"]
