"""Experiments: record, diagnose, and design the motion that answers what is still open."""

from lieid_casadi.experiments.experiment import experiment
from lieid_casadi.experiments.motion import PlannedMotion
from lieid_casadi.experiments.purpose import Purpose
from lieid_casadi.experiments.result import Experiment, Round

__all__ = ["Experiment", "PlannedMotion", "Purpose", "Round", "experiment"]
