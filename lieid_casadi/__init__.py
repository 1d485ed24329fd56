"""Dynamic models of serial robot arms: identified, compared with measurements, completed."""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

__version__ = "0.2.0"

__all__ = [
    "Coefficient",
    "Comparison",
    "Compiled",
    "Diagnosis",
    "DriveGains",
    "Effect",
    "Excitation",
    "Fit",
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
    "compare",
    "compile",
    "diagnose",
    "drive_gains",
    "effect",
    "excite",
    "extend",
    "identify",
    "identify_in_stages",
    "identify_payload",
    "register",
    "robots",
    "symbolic",
]

# where each name is defined; imported on first use, so that importing the package is quick
_HOME = {
    "Coefficient": "lieid_casadi.effects",
    "Comparison": "lieid_casadi.comparison",
    "Compiled": "lieid_casadi.compiled",
    "Diagnosis": "lieid_casadi.diagnosis",
    "DriveGains": "lieid_casadi.gains",
    "Effect": "lieid_casadi.effects",
    "Excitation": "lieid_casadi.excitation",
    "Fit": "lieid_casadi.identification",
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
    "compare": "lieid_casadi.comparison",
    "compile": "lieid_casadi.compiled",
    "diagnose": "lieid_casadi.diagnosis",
    "drive_gains": "lieid_casadi.gains",
    "effect": "lieid_casadi.effects",
    "excite": "lieid_casadi.excitation",
    "extend": "lieid_casadi.diagnosis",
    "identify": "lieid_casadi.identification",
    "identify_in_stages": "lieid_casadi.friction_curves",
    "identify_payload": "lieid_casadi.payload",
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
    from lieid_casadi.effects import Coefficient, Effect, Shape, Signals, effect, register
    from lieid_casadi.errors import LieidError, LieidWarning
    from lieid_casadi.excitation.excitation import Excitation
    from lieid_casadi.excitation.excite import excite
    from lieid_casadi.expressions.symbolic import symbolic
    from lieid_casadi.expressions.symbolic_dynamics import SymbolicDynamics
    from lieid_casadi.friction_curves.stages import StagedFit, identify_in_stages
    from lieid_casadi.gains.estimate import DriveGains
    from lieid_casadi.gains.identify import drive_gains
    from lieid_casadi.identification.fit import Fit
    from lieid_casadi.identification.identify import identify
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
