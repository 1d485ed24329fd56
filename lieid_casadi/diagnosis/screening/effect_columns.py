"""Columns of effects along processed segments, evaluated without compiling a model."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache, cached_property

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from lieid_casadi.diagnosis.screening.effect_memory import OWN, signals_of, states_along
from lieid_casadi.diagnosis.screening.numpy_evaluation import ArrayFunction
from lieid_casadi.effects import Effect, Placement, Signals
from lieid_casadi.expressions.model_functions import ramp
from lieid_casadi.identification import Fit
from lieid_casadi.identification.regression.segment_columns import ModelAlongSegment, model_along
from lieid_casadi.recording import Processed

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class SegmentSignals:
    """The signals that effects depend on, along one segment.

    Attributes
    ----------
    segment : Processed
        Of K instants.
    values : dict
        Signal → (K, n).
    arm : ModelAlongSegment
        The model along the segment, for effects that are computed along the whole of it.
    """

    segment: Processed
    values: dict[str, Array]
    arm: ModelAlongSegment

    @classmethod
    def of(cls, fit: Fit, segment: Processed, *, model_fixed: bool = False) -> SegmentSignals:
        """Return the signals of a segment; the load is that of the fit.

        Parameters
        ----------
        fit : Fit
        segment : Processed
        model_fixed : bool
            Whether the model is not fitted again. Its friction at starts and stops then does not
            adapt to the segment, and friction at rest counts as unknown.
        """
        arm = model_along(fit.compiled, segment, fit.shapes, fit.parameters)
        arm = replace(arm, unknown_at_rest=model_fixed)
        load = arm.load
        shape = segment.q.shape
        temperature, error = segment.temperature, segment.command_error
        time = np.broadcast_to((segment.t - segment.t[0])[:, None], shape)
        return cls(
            segment,
            {
                "q": segment.q,
                "dq": segment.dq,
                "ddq": segment.ddq,
                "sign": _sign()(segment.dq, segment.dead_zone)[0],
                "load": load,
                "temperature": np.zeros(shape) if temperature is None else temperature,
                "time": np.array(time),
                "command_error": np.zeros(shape) if error is None else error,
            },
            arm,
        )


@cache
def _sign() -> ArrayFunction:
    dq, width = ca.SX.sym("dq"), ca.SX.sym("width")
    return ArrayFunction([dq, width], [ramp(dq, width)])


class EffectFunction:
    """One effect as a function of the signals of one joint (two, for couplings)."""

    def __init__(self, effect: Effect) -> None:
        self.effect = effect
        self._own = {name: ca.SX.sym(name) for name in OWN}
        self._other = {name: ca.SX.sym(f"other_{name}") for name in OWN}
        self._shapes = [ca.SX.sym(shape.name) for shape in effect.shapes]
        self._states = [ca.SX.sym(state.name) for state in effect.states]

    @cached_property
    def _columns(self) -> ArrayFunction:
        inputs = [*self._own.values(), *self._other.values(), *self._shapes, *self._states]
        return ArrayFunction(inputs, self.effect.columns(self._signals(), self._shape))

    @property
    def _shape(self) -> dict[str, ca.SX]:
        return {s.name: x for s, x in zip(self.effect.shapes, self._shapes, strict=True)}

    def _signals(self) -> Signals:
        state = {s.name: x for s, x in zip(self.effect.states, self._states, strict=True)}
        other = signals_of(self._other) if self.effect.couples else None
        return replace(signals_of(self._own), other=other, state=state)

    def at(self, values: Mapping[str, Array], grid: Array) -> Array:
        """Return the columns (c, N, G) of an effect with one shape parameter.

        Parameters
        ----------
        values : mapping
            Signal → (N,).
        grid : (G,)
            Values of the shape parameter.
        """
        own = [values[name][:, None] for name in OWN]
        results = self._columns(*own, *own, grid)
        shape = (len(own[0]), len(grid))
        return np.array([np.broadcast_to(x, shape) for x in results])

    def columns(
        self, signals: SegmentSignals, places: Sequence[tuple[int, int | None]], grid: Array
    ) -> Array:
        """Return the columns (K, places, G, c), not filtered.

        Parameters
        ----------
        signals : SegmentSignals
            Of K instants.
        places : sequence of (joint, source)
            From 0; the source is None except for couplings.
        grid : (G, s)
            Shape parameters.
        """
        own = [signals.values[name][:, [j for j, _ in places], None] for name in OWN]
        other = own
        if self.effect.couples:
            other = [signals.values[name][:, [s or 0 for _, s in places], None] for name in OWN]
        states = states_along(self.effect, own, grid) if self.effect.states else []
        results = self._columns(*own, *other, *grid.T, *states)
        shape = (len(signals.segment), len(places), len(grid))
        return np.stack([np.broadcast_to(x, shape) for x in results], axis=-1)


def columns_along(
    function: EffectFunction, signals: SegmentSignals, placements: Sequence[Placement], grid: Array
) -> Array:
    """Return filtered columns of one effect in several places.

    Parameters
    ----------
    function : EffectFunction
    signals : SegmentSignals
    placements : sequence of Placement
    grid : (G, s)
        Shape parameters.

    Returns
    -------
    (M, places, G, c) array
        At the M filtered instants of the segment.
    """
    places = [(p.joint, p.source) for p in placements]
    raw = function.columns(signals, places, grid)
    return signals.segment.filter(raw.reshape(len(raw), -1)).reshape(-1, *raw.shape[1:])
