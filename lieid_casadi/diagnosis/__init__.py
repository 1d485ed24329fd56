"""Which physical effect is missing, on which joint, and how sure that is."""

from lieid_casadi.diagnosis.diagnose import diagnose
from lieid_casadi.diagnosis.diagnosis import Diagnosis, Evidence, Step
from lieid_casadi.diagnosis.extend import Extension, extend
from lieid_casadi.diagnosis.residual.unexplained import Unexplained
from lieid_casadi.diagnosis.residual.user_effect_code import OwnEffects, own_effects
from lieid_casadi.diagnosis.search.search_results import Proposal

__all__ = [
    "Diagnosis",
    "Evidence",
    "Extension",
    "OwnEffects",
    "Proposal",
    "Step",
    "Unexplained",
    "diagnose",
    "extend",
    "own_effects",
]
