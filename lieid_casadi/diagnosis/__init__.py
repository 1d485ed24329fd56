"""Diagnosis of a model: effects that it lacks, or changes since it was fitted."""

from lieid_casadi.diagnosis.diagnose import diagnose
from lieid_casadi.diagnosis.extend import Extension, extend
from lieid_casadi.diagnosis.gates import Proposal
from lieid_casadi.diagnosis.options import DiagnosisOptions
from lieid_casadi.diagnosis.result import Diagnosis
from lieid_casadi.diagnosis.step import Difference, Evidence, Fall, Rival, Step, Unexplained

__all__ = [
    "Diagnosis",
    "DiagnosisOptions",
    "Difference",
    "Evidence",
    "Extension",
    "Fall",
    "Proposal",
    "Rival",
    "Step",
    "Unexplained",
    "diagnose",
    "extend",
]
