"""Whether robot and recording belong together: premises, tested before any physics."""

from lieid_casadi.premises.check import check, check_where_possible
from lieid_casadi.premises.correction import Correction
from lieid_casadi.premises.findings import Finding, PremiseCheck

__all__ = ["Correction", "Finding", "PremiseCheck", "check", "check_where_possible"]
