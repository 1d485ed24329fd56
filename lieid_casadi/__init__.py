"""Dynamic models of serial robot arms: identified, compared with measurements, completed."""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

__version__ = "0.2.0"

__all__ = [
    "Batch", "CartesianSpeed", "Coefficient", "Comparison", "Compiled", "Diagnosis",
    "Discrimination", "Drive", "DriveGains", "Effect", "Excitation", "Experiment", "Export",
    "Fit", "FrictionFit", "Joint", "LieidError", "LieidWarning", "Limits", "Model", "Obstacle",
    "PayloadEstimate", "PlannedMotion", "PremiseCheck", "Processing", "Recording", "Robot",
    "SelfCollision", "Shape", "Signals", "Simulation", "SymbolicDynamics", "Torque", "Wall",
    "__version__", "check", "compare", "compile", "default_limits", "diagnose", "discriminate",
    "drive_gains", "effect", "excite", "experiment", "export", "extend", "floor", "friction",
    "identify", "identify_payload", "predict", "register", "robots", "servo_drive", "simulate",
    "symbolic", "workspace_box",
]  # fmt: skip

# where each name is defined; imported on first use, so that importing the package is quick
_HOME = {
    name: module
    for module, names in {
        "comparison": "Comparison compare",
        "compiled": "Compiled compile",
        "diagnosis": "Diagnosis diagnose extend",
        "discrimination": "Discrimination discriminate",
        "effects": "Coefficient Effect Shape Signals effect register",
        "errors": "LieidError LieidWarning",
        "excitation": (
            "CartesianSpeed Excitation Obstacle SelfCollision Torque Wall default_limits "
            "excite floor workspace_box"
        ),
        "experiments": "Experiment PlannedMotion experiment",
        "exporters.export": "Export export",
        "expressions.symbolic": "SymbolicDynamics symbolic",
        "friction_curves": "FrictionFit friction",
        "gains": "DriveGains drive_gains",
        "identification": "Fit identify",
        "identification.fit": "predict",
        "model": "Model",
        "payload": "PayloadEstimate identify_payload",
        "premises": "PremiseCheck check",
        "recording": "Processing Recording",
        "robot": "Drive Joint Limits Robot servo_drive",
        "simulation": "Batch Simulation simulate",
    }.items()
    for name in names.split()
}

if TYPE_CHECKING:
    from lieid_casadi import robots
    from lieid_casadi.comparison.compare import compare
    from lieid_casadi.comparison.comparison import Comparison
    from lieid_casadi.compiled import Compiled, compile
    from lieid_casadi.diagnosis.diagnose import diagnose
    from lieid_casadi.diagnosis.extend import extend
    from lieid_casadi.diagnosis.result import Diagnosis
    from lieid_casadi.discrimination.discriminate import discriminate
    from lieid_casadi.discrimination.discrimination import Discrimination
    from lieid_casadi.effects import Coefficient, Effect, Shape, Signals, effect, register
    from lieid_casadi.errors import LieidError, LieidWarning
    from lieid_casadi.excitation import (
        CartesianSpeed,
        Obstacle,
        SelfCollision,
        Torque,
        Wall,
        default_limits,
        floor,
        workspace_box,
    )
    from lieid_casadi.excitation.excite import Excitation, excite
    from lieid_casadi.experiments.experiment import experiment
    from lieid_casadi.experiments.motion import PlannedMotion
    from lieid_casadi.experiments.result import Experiment
    from lieid_casadi.exporters.export import Export, export
    from lieid_casadi.expressions.symbolic import SymbolicDynamics, symbolic
    from lieid_casadi.friction_curves import FrictionFit, friction
    from lieid_casadi.gains import DriveGains, drive_gains
    from lieid_casadi.identification.fit import Fit, predict
    from lieid_casadi.identification.identify import identify
    from lieid_casadi.model import Model
    from lieid_casadi.payload import PayloadEstimate, identify_payload
    from lieid_casadi.premises.check import check
    from lieid_casadi.premises.findings import PremiseCheck
    from lieid_casadi.recording import Processing, Recording
    from lieid_casadi.robot import Drive, Joint, Limits, Robot, servo_drive
    from lieid_casadi.simulation.integration import Batch
    from lieid_casadi.simulation.simulate import Simulation, simulate


def __getattr__(name: str) -> Any:
    if name == "robots":
        return importlib.import_module("lieid_casadi.robots")
    if name not in _HOME:
        raise AttributeError(f"module 'lieid_casadi' has no attribute {name!r}")
    return getattr(importlib.import_module(f"lieid_casadi.{_HOME[name]}"), name)


def __dir__() -> list[str]:
    return sorted(__all__)
