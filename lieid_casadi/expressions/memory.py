"""States of effects with memory along a segment of samples."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from lieid_casadi.arrays import Array
from lieid_casadi.expressions.model_functions import SIGNAL_NAMES, STEPS, ModelFunctions


def states_along(functions: ModelFunctions, signals: Mapping[str, Array]) -> Array:
    """Return the states (N, S) at every sample of one segment.

    The first sample has the initial states; each further one follows from the sample before it,
    whatever the time between them. States are held at samples that are not finite
    (`Effect.next_states`).

    ``signals``: ``q`` and, where known, ``dq``, ``ddq``, ``load``, ``temperature`` (N, n) and
    ``time`` (N, 1); ``shapes`` (s,) and ``dead_zone`` (n,). Signals that are left out are zero.
    """
    samples, model = len(signals["q"]), functions.model
    states = np.empty((samples, len(model.states)))
    if not samples:
        return states
    states[0] = current = model.initial_states
    series = [_series(signals, name, samples, model.n) for name in SIGNAL_NAMES]
    constants = [
        np.repeat(np.reshape(signals[name], (-1, 1)), STEPS, axis=1)
        for name in ("shapes", "dead_zone")
    ]
    for first in range(0, samples - 1, STEPS):
        # the last chunk is filled with the last sample; the surplus results are discarded
        rows = np.minimum(np.arange(first, first + STEPS + 1), samples - 1)
        chunk = [x[:, rows] for x in series]
        result = functions.steps(
            current, *(x[:, :-1] for x in chunk), *(x[:, 1:] for x in chunk), *constants
        ).full()
        count = min(STEPS, samples - 1 - first)
        states[first + 1 : first + 1 + count] = result[:, :count].T
        current = result[:, count - 1]
    return states


def _series(signals: Mapping[str, Array], name: str, samples: int, n: int) -> Array:
    if name in signals:
        return np.reshape(signals[name], (samples, -1)).T
    return np.zeros((1 if name == "time" else n, samples))
