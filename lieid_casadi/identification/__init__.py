"""From a model and recordings to a fit."""

from lieid_casadi.identification.fit import Fit
from lieid_casadi.identification.identify import identify

__all__ = ["Fit", "identify"]
