"""Physical effects other than the rigid body: one file each, one definition for every use.

Importing the package imports every module in it, which registers its effects: adding an effect
to the library is adding one file.
"""

from importlib import import_module
from pkgutil import iter_modules

from lieid_casadi.effects.arm_effect import ArmEffect, InstantModel, SegmentModel
from lieid_casadi.effects.effect import Coefficient, Effect, MemoryState, Shape, Signals
from lieid_casadi.effects.placement import Placement, parse_effects, place
from lieid_casadi.effects.registry import REGISTER, effect, make, register

for _module in iter_modules(__path__):
    import_module(f"{__name__}.{_module.name}")

#: The built-in effects, in alphabetical order of their modules.
LIBRARY: tuple[type[Effect], ...] = tuple(
    dict.fromkeys(variant.kind for variant in REGISTER.values())
)

__all__ = [
    "LIBRARY", "ArmEffect", "Coefficient", "Effect", "InstantModel", "MemoryState", "Placement",
    "SegmentModel", "Shape", "Signals", "effect", "make", "parse_effects", "place", "register",
]  # fmt: skip
