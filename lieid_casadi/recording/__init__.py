"""Recordings of arms: load, check, process."""

from lieid_casadi.recording.checks.check import check
from lieid_casadi.recording.checks.units import require_plausible_units
from lieid_casadi.recording.joining import join
from lieid_casadi.recording.processing.periods import detect_period, period_noise
from lieid_casadi.recording.processing.process import Processed, Processing, process
from lieid_casadi.recording.processing.spectrum import choose_cutoff, noise_dead_zone
from lieid_casadi.recording.recording import Recording
from lieid_casadi.recording.recording_stream import RecordingStream, load_or_stream, stream

__all__ = [
    "Processed",
    "Processing",
    "Recording",
    "RecordingStream",
    "check",
    "choose_cutoff",
    "detect_period",
    "join",
    "load_or_stream",
    "noise_dead_zone",
    "period_noise",
    "process",
    "require_plausible_units",
    "stream",
]
