"""Dynamic models of serial robot arms: identify them, see where they fail, learn what is missing."""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

__version__ = "0.1.0"

# name → module that defines it; imported on first use, so that importing the package is quick
_HOME = {
    "Coefficient": "lieid_casadi.effects",
    "Comparison": "lieid_casadi.comparison",
    "Compiled": "lieid_casadi.compiled",
    "Effect": "lieid_casadi.effects",
    "Fit": "lieid_casadi.identification",
    "Joint": "lieid_casadi.robot",
    "LieidError": "lieid_casadi.errors",
    "LieidWarning": "lieid_casadi.errors",
    "Limits": "lieid_casadi.robot",
    "Model": "lieid_casadi.model",
    "Processing": "lieid_casadi.recording",
    "Recording": "lieid_casadi.recording",
    "Robot": "lieid_casadi.robot",
    "Shape": "lieid_casadi.effects",
    "Signals": "lieid_casadi.effects",
    "compare": "lieid_casadi.comparison",
    "compile": "lieid_casadi.compiled",
    "effect": "lieid_casadi.effects",
    "identify": "lieid_casadi.identification",
    "register": "lieid_casadi.effects",
}

__all__ = [*sorted(_HOME), "__version__", "robots"]  # noqa: PLE0604

if TYPE_CHECKING:
    from lieid_casadi import robots as robots
    from lieid_casadi.comparison import Comparison as Comparison
    from lieid_casadi.comparison import compare as compare
    from lieid_casadi.compiled import Compiled as Compiled
    from lieid_casadi.compiled import compile as compile
    from lieid_casadi.effects import Coefficient as Coefficient
    from lieid_casadi.effects import Effect as Effect
    from lieid_casadi.effects import Shape as Shape
    from lieid_casadi.effects import Signals as Signals
    from lieid_casadi.effects import effect as effect
    from lieid_casadi.effects import register as register
    from lieid_casadi.errors import LieidError as LieidError
    from lieid_casadi.errors import LieidWarning as LieidWarning
    from lieid_casadi.identification import Fit as Fit
    from lieid_casadi.identification import identify as identify
    from lieid_casadi.model import Model as Model
    from lieid_casadi.recording import Processing as Processing
    from lieid_casadi.recording import Recording as Recording
    from lieid_casadi.robot import Joint as Joint
    from lieid_casadi.robot import Limits as Limits
    from lieid_casadi.robot import Robot as Robot


def __getattr__(name: str) -> Any:
    if name == "robots":
        return importlib.import_module("lieid_casadi.robots")
    if name not in _HOME:
        raise AttributeError(f"module 'lieid_casadi' has no attribute {name!r}")
    return getattr(importlib.import_module(_HOME[name]), name)


def __dir__() -> list[str]:
    return sorted(__all__)
