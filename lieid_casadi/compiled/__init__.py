"""A model's functions on batches of samples: compiled C, or CasADi's virtual machine."""

from lieid_casadi.compiled.batch_evaluation import BaseBlocks
from lieid_casadi.compiled.compiled_model import Compiled, compile

__all__ = ["BaseBlocks", "Compiled", "compile"]
