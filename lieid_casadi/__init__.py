"""Dynamic models of serial robot arms: identified, compared with measurements, completed."""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

__version__ = "0.2.0"

__all__ = [
    "Bootstrap",
    "Coefficient",
    "Comparison",
    "Compiled",
    "Diagnosis",
    "Discrimination",
    "DriveGains",
    "Effect",
    "Excitation",
    "Export",
    "Fit",
    "FrictionFit",
    "Joint",
    "LieidError",
    "LieidWarning",
    "Limits",
    "Model",
    "PayloadEstimate",
    "Processing",
    "Recording",
    "Robot",
    "Shape",
    "Signals",
    "StagedFit",
    "SymbolicDynamics",
    "__version__",
    "bootstrap",
    "compare",
    "compile",
    "diagnose",
    "discriminate",
    "drive_gains",
    "effect",
    "excite",
    "export",
    "extend",
    "friction",
    "identify",
    "identify_in_stages",
    "identify_payload",
    "predict",
    "register",
    "robots",
    "symbolic",
]

# where each name is defined; imported on first use, so that importing the package is quick
_HOME = {
    "Bootstrap": "lieid_casadi.identification.uncertainty.bootstrap",
    "Coefficient": "lieid_casadi.effects",
    "Comparison": "lieid_casadi.comparison",
    "Compiled": "lieid_casadi.compiled",
    "Diagnosis": "lieid_casadi.diagnosis",
    "Discrimination": "lieid_casadi.discrimination",
    "DriveGains": "lieid_casadi.gains",
    "Effect": "lieid_casadi.effects",
    "Excitation": "lieid_casadi.excitation",
    "Export": "lieid_casadi.exporters.export",
    "Fit": "lieid_casadi.identification",
    "FrictionFit": "lieid_casadi.friction_curves",
    "Joint": "lieid_casadi.robot",
    "LieidError": "lieid_casadi.errors",
    "LieidWarning": "lieid_casadi.errors",
    "Limits": "lieid_casadi.robot",
    "Model": "lieid_casadi.model",
    "PayloadEstimate": "lieid_casadi.payload",
    "Processing": "lieid_casadi.recording",
    "Recording": "lieid_casadi.recording",
    "Robot": "lieid_casadi.robot",
    "Shape": "lieid_casadi.effects",
    "Signals": "lieid_casadi.effects",
    "StagedFit": "lieid_casadi.friction_curves",
    "SymbolicDynamics": "lieid_casadi.expressions.symbolic_dynamics",
    "bootstrap": "lieid_casadi.identification.uncertainty.bootstrap",
    "compare": "lieid_casadi.comparison",
    "compile": "lieid_casadi.compiled",
    "diagnose": "lieid_casadi.diagnosis",
    "discriminate": "lieid_casadi.discrimination",
    "drive_gains": "lieid_casadi.gains",
    "effect": "lieid_casadi.effects",
    "excite": "lieid_casadi.excitation",
    "export": "lieid_casadi.exporters.export",
    "extend": "lieid_casadi.diagnosis",
    "friction": "lieid_casadi.friction_curves",
    "identify": "lieid_casadi.identification",
    "identify_in_stages": "lieid_casadi.friction_curves",
    "identify_payload": "lieid_casadi.payload",
    "predict": "lieid_casadi.identification.prediction",
    "register": "lieid_casadi.effects",
    "symbolic": "lieid_casadi.expressions.symbolic",
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
    from lieid_casadi.excitation.excitation import Excitation
    from lieid_casadi.excitation.excite import excite
    from lieid_casadi.exporters.export import Export, export
    from lieid_casadi.expressions.symbolic import symbolic
    from lieid_casadi.expressions.symbolic_dynamics import SymbolicDynamics
    from lieid_casadi.friction_curves.friction import friction
    from lieid_casadi.friction_curves.friction_fit import FrictionFit
    from lieid_casadi.friction_curves.stages import StagedFit, identify_in_stages
    from lieid_casadi.gains.estimate import DriveGains
    from lieid_casadi.gains.identify import drive_gains
    from lieid_casadi.identification.fit import Fit
    from lieid_casadi.identification.identify import identify
    from lieid_casadi.identification.prediction import predict
    from lieid_casadi.identification.uncertainty.bootstrap import Bootstrap, bootstrap
    from lieid_casadi.model import Model
    from lieid_casadi.payload.estimate import PayloadEstimate
    from lieid_casadi.payload.identify import identify_payload
    from lieid_casadi.recording import Processing, Recording
    from lieid_casadi.robot import Joint, Limits, Robot


def __getattr__(name: str) -> Any:
    if name == "robots":
        return importlib.import_module("lieid_casadi.robots")
    if name not in _HOME:
        raise AttributeError(f"module 'lieid_casadi' has no attribute {name!r}")
    return getattr(importlib.import_module(_HOME[name]), name)


def __dir__() -> list[str]:
    return sorted(__all__)
