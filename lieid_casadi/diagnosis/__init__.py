"""Which physical effect is missing, on which joint, and how sure that is."""

from lieid_casadi.diagnosis.diagnose import diagnose
from lieid_casadi.diagnosis.diagnosis import Diagnosis, Evidence, Step
from lieid_casadi.diagnosis.extend import Extension, extend
from lieid_casadi.diagnosis.selection import Proposal

__all__ = ["Diagnosis", "Evidence", "Extension", "Proposal", "Step", "diagnose", "extend"]
