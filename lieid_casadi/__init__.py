"""Dynamic models of serial robot arms: identified, compared with measurements, completed."""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

__version__ = "0.2.0"

__all__ = [
    "BSpline",
    "Basis",
    "Bootstrap",
    "CartesianSpeed",
    "Coefficient",
    "Comparison",
    "Compiled",
    "Diagnosis",
    "Discrimination",
    "Drive",
    "DriveGains",
    "Effect",
    "Excitation",
    "Export",
    "ExpressionLimit",
    "Fit",
    "Fourier",
    "FrictionFit",
    "Joint",
    "LieidError",
    "LieidWarning",
    "Limits",
    "Model",
    "ModifiedFourier",
    "Obstacle",
    "PayloadEstimate",
    "Processing",
    "Recording",
    "Robot",
    "SelfCollision",
    "Shape",
    "Signals",
    "Simulation",
    "StagedFit",
    "SymbolicDynamics",
    "Symbols",
    "Torque",
    "Wall",
    "__version__",
    "bootstrap",
    "compare",
    "compile",
    "default_limits",
    "diagnose",
    "discriminate",
    "drive_gains",
    "effect",
    "excite",
    "export",
    "extend",
    "floor",
    "friction",
    "identify",
    "identify_in_stages",
    "identify_payload",
    "jerk_limit",
    "predict",
    "register",
    "robots",
    "servo_drive",
    "simulate",
    "symbolic",
    "workspace_box",
]

# where each name is defined; imported on first use, so that importing the package is quick
_HOME = {
    "BSpline": "lieid_casadi.excitation",
    "Basis": "lieid_casadi.excitation",
    "Bootstrap": "lieid_casadi.identification.uncertainty.bootstrap",
    "CartesianSpeed": "lieid_casadi.excitation",
    "Coefficient": "lieid_casadi.effects",
    "Comparison": "lieid_casadi.comparison",
    "Compiled": "lieid_casadi.compiled",
    "Diagnosis": "lieid_casadi.diagnosis",
    "Discrimination": "lieid_casadi.discrimination",
    "Drive": "lieid_casadi.robot",
    "DriveGains": "lieid_casadi.gains",
    "Effect": "lieid_casadi.effects",
    "Excitation": "lieid_casadi.excitation",
    "Export": "lieid_casadi.exporters.export",
    "ExpressionLimit": "lieid_casadi.excitation",
    "Fit": "lieid_casadi.identification",
    "Fourier": "lieid_casadi.excitation",
    "FrictionFit": "lieid_casadi.friction_curves",
    "Joint": "lieid_casadi.robot",
    "LieidError": "lieid_casadi.errors",
    "LieidWarning": "lieid_casadi.errors",
    "Limits": "lieid_casadi.robot",
    "Model": "lieid_casadi.model",
    "ModifiedFourier": "lieid_casadi.excitation",
    "Obstacle": "lieid_casadi.excitation",
    "PayloadEstimate": "lieid_casadi.payload",
    "Processing": "lieid_casadi.recording",
    "Recording": "lieid_casadi.recording",
    "Robot": "lieid_casadi.robot",
    "SelfCollision": "lieid_casadi.excitation",
    "Shape": "lieid_casadi.effects",
    "Signals": "lieid_casadi.effects",
    "Simulation": "lieid_casadi.simulation",
    "StagedFit": "lieid_casadi.friction_curves",
    "SymbolicDynamics": "lieid_casadi.expressions.symbolic",
    "Symbols": "lieid_casadi.excitation",
    "Torque": "lieid_casadi.excitation",
    "Wall": "lieid_casadi.excitation",
    "bootstrap": "lieid_casadi.identification.uncertainty.bootstrap",
    "compare": "lieid_casadi.comparison",
    "compile": "lieid_casadi.compiled",
    "default_limits": "lieid_casadi.excitation",
    "diagnose": "lieid_casadi.diagnosis",
    "discriminate": "lieid_casadi.discrimination",
    "drive_gains": "lieid_casadi.gains",
    "effect": "lieid_casadi.effects",
    "excite": "lieid_casadi.excitation",
    "export": "lieid_casadi.exporters.export",
    "extend": "lieid_casadi.diagnosis",
    "floor": "lieid_casadi.excitation",
    "friction": "lieid_casadi.friction_curves",
    "identify": "lieid_casadi.identification",
    "identify_in_stages": "lieid_casadi.friction_curves",
    "identify_payload": "lieid_casadi.payload",
    "jerk_limit": "lieid_casadi.excitation",
    "predict": "lieid_casadi.identification.prediction",
    "register": "lieid_casadi.effects",
    "servo_drive": "lieid_casadi.robot",
    "simulate": "lieid_casadi.simulation",
    "symbolic": "lieid_casadi.expressions.symbolic",
    "workspace_box": "lieid_casadi.excitation",
}

if TYPE_CHECKING:
    from lieid_casadi import robots
    from lieid_casadi.comparison.compare import compare
    from lieid_casadi.comparison.comparison import Comparison
    from lieid_casadi.compiled import Compiled, compile
    from lieid_casadi.diagnosis.diagnose import diagnose
    from lieid_casadi.diagnosis.diagnosis import Diagnosis
    from lieid_casadi.diagnosis.extend import extend
    from lieid_casadi.discrimination.discriminate import discriminate
    from lieid_casadi.discrimination.discrimination import Discrimination
    from lieid_casadi.effects import Coefficient, Effect, Shape, Signals, effect, register
    from lieid_casadi.errors import LieidError, LieidWarning
    from lieid_casadi.excitation import (
        Basis,
        BSpline,
        CartesianSpeed,
        ExpressionLimit,
        Fourier,
        ModifiedFourier,
        Obstacle,
        SelfCollision,
        Symbols,
        Torque,
        Wall,
        default_limits,
        floor,
        jerk_limit,
        workspace_box,
    )
    from lieid_casadi.excitation.excite import Excitation, excite
    from lieid_casadi.exporters.export import Export, export
    from lieid_casadi.expressions.symbolic import SymbolicDynamics, symbolic
    from lieid_casadi.friction_curves.friction_fit import FrictionFit, friction
    from lieid_casadi.friction_curves.stages import StagedFit, identify_in_stages
    from lieid_casadi.gains.identify import DriveGains, drive_gains
    from lieid_casadi.identification.fit import Fit
    from lieid_casadi.identification.identify import identify
    from lieid_casadi.identification.prediction import predict
    from lieid_casadi.identification.uncertainty.bootstrap import Bootstrap, bootstrap
    from lieid_casadi.model import Model
    from lieid_casadi.payload.estimate import PayloadEstimate
    from lieid_casadi.payload.identify import identify_payload
    from lieid_casadi.recording import Processing, Recording
    from lieid_casadi.robot import Drive, Joint, Limits, Robot, servo_drive
    from lieid_casadi.simulation.simulate import Simulation, simulate


def __getattr__(name: str) -> Any:
    if name == "robots":
        return importlib.import_module("lieid_casadi.robots")
    if name not in _HOME:
        raise AttributeError(f"module 'lieid_casadi' has no attribute {name!r}")
    return getattr(importlib.import_module(_HOME[name]), name)


def __dir__() -> list[str]:
    return sorted(__all__)
