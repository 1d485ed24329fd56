"""Which physical effect is missing, on which joint, and how sure that is."""

from lieid_casadi.diagnosis.diagnose import diagnose
from lieid_casadi.diagnosis.diagnosis import Diagnosis, Evidence, Step

__all__ = ["Diagnosis", "Evidence", "Step", "diagnose"]
