"""A model's functions on batches: C on vector registers, or CasADi's virtual machine."""

from lieid_casadi.compiled.arm import Compiled, compile
from lieid_casadi.compiled.blocks import BaseBlocks

__all__ = ["BaseBlocks", "Compiled", "compile"]
