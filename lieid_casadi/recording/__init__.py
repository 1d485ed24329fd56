"""Recordings of arms: load, check, process."""

from lieid_casadi.recording.periods import detect_period, period_noise
from lieid_casadi.recording.plausibility import check, require_plausible_units
from lieid_casadi.recording.processed import Processed, Processing, process
from lieid_casadi.recording.recording import Recording
from lieid_casadi.recording.spectrum import choose_cutoff, noise_dead_zone

__all__ = [
    "Processed",
    "Processing",
    "Recording",
    "check",
    "choose_cutoff",
    "detect_period",
    "noise_dead_zone",
    "period_noise",
    "process",
    "require_plausible_units",
]
