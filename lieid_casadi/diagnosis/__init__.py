"""Diagnosis of a model: effects that it lacks, or changes since it was fitted."""

from lieid_casadi.diagnosis.change_torque import change_torque
from lieid_casadi.diagnosis.diagnose import diagnose
from lieid_casadi.diagnosis.diagnosis import Diagnosis
from lieid_casadi.diagnosis.diagnosis_step import DiagnosisStep, Evidence
from lieid_casadi.diagnosis.extend import Extension, extend
from lieid_casadi.diagnosis.options import DiagnosisOptions
from lieid_casadi.diagnosis.residual.unexplained import Unexplained
from lieid_casadi.diagnosis.residual.user_effect_code import OwnEffects, own_effects
from lieid_casadi.diagnosis.search.search_results import Proposal

__all__ = [
    "Diagnosis",
    "DiagnosisOptions",
    "DiagnosisStep",
    "Evidence",
    "Extension",
    "OwnEffects",
    "Proposal",
    "Unexplained",
    "change_torque",
    "diagnose",
    "extend",
    "own_effects",
]
