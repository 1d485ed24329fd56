"""States of effects with memory by compiled code, one sample after the other."""

from __future__ import annotations

import ctypes
from collections.abc import Mapping

import numpy as np

from lieid_casadi.arrays import Array
from lieid_casadi.compiled.kernel_source import CONSTANT_ARGUMENTS
from lieid_casadi.compiled.kernels import Kernels
from lieid_casadi.expressions import model_functions

BEFORE = "before_"  # prefix of arguments that belong to the sample before


def states_along(kernels: Kernels, signals: Mapping[str, Array]) -> Array:
    """Return the states (N, S) at every sample of one segment; see `model_functions.states_along`.

    ``kernels``: those of one lane, because each sample depends on the one before it; ``signals``:
    arrays by name.
    """
    compiled = kernels.get(["memory"])
    if compiled is None:
        return model_functions.states_along(kernels.functions, signals)
    runtime, (kernel,) = compiled
    assert runtime.states is not None
    model, samples = kernels.functions.model, len(signals["q"])
    states = np.empty((samples, len(model.states)))
    states[:1] = model.initial_states
    arrays = {name: np.ascontiguousarray(array) for name, array in signals.items()}
    nothing = np.zeros(max(width for _, width in kernel.arguments))
    pointers = (ctypes.c_void_p * len(kernel.arguments))()
    steps = np.zeros(len(kernel.arguments), dtype=np.int64)
    for k, (name, width) in enumerate(kernel.arguments):
        before = name.startswith(BEFORE) or name == "states"
        array = states if name == "states" else arrays.get(name.removeprefix(BEFORE))
        if array is None or width == 0:
            pointers[k] = nothing.ctypes.data
        elif name in CONSTANT_ARGUMENTS:
            pointers[k] = array.ctypes.data
        else:
            steps[k] = width
            pointers[k] = array.ctypes.data + (0 if before else array.strides[0])
    if runtime.states(
        kernel.address, len(steps), ctypes.addressof(pointers), steps.ctypes.data,
        states.shape[1], states.ctypes.data, samples,
    ):  # fmt: skip
        raise MemoryError
    return states
