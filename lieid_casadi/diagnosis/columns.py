"""Columns of any effect along processed segments, without compiling a model for each of them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from lieid_casadi.diagnosis.vectorized import Vectorized
from lieid_casadi.effects import Effect, Placement, Signals
from lieid_casadi.recording import Processed

Array = NDArray[np.float64]
OWN = ("q", "dq", "ddq", "sign", "load", "temperature", "time")


@dataclass(frozen=True, eq=False)
class SegmentSignals:
    """What effects see along one segment, each signal (K, n)."""

    segment: Processed
    values: dict[str, Array]

    @classmethod
    def of(cls, segment: Processed, load: Array) -> SegmentSignals:
        """Return the signals of a segment, given the rigid torque (K, n)."""
        shape = segment.q.shape
        warmth = segment.temperature
        time = np.broadcast_to((segment.t - segment.t[0])[:, None], shape)
        return cls(
            segment,
            {
                "q": segment.q,
                "dq": segment.dq,
                "ddq": segment.ddq,
                "sign": np.clip(segment.dq / np.maximum(segment.dead_zone, 1e-200), -1.0, 1.0),
                "load": load,
                "temperature": np.zeros(shape) if warmth is None else warmth,
                "time": np.array(time),
            },
        )


class EffectFunction:
    """One effect as a function of the signals of one joint (two, for couplings)."""

    def __init__(self, effect: Effect) -> None:
        self.effect = effect
        self._own = {name: ca.SX.sym(name) for name in OWN}
        self._other = {name: ca.SX.sym(f"other_{name}") for name in OWN}
        self._shapes = [ca.SX.sym(shape.name) for shape in effect.shapes]
        self._states = [ca.SX.sym(state.name) for state in effect.states]

    @cached_property
    def _columns(self) -> Vectorized:
        inputs = [*self._own.values(), *self._other.values(), *self._shapes, *self._states]
        return Vectorized(inputs, self.effect.columns(self._signals(), self._shape))

    @cached_property
    def _advance(self) -> Vectorized:
        now = Signals(**{name: ca.SX.sym(f"now_{name}") for name in OWN})
        inputs = [*self._states, *self._own.values(), *(getattr(now, name) for name in OWN)]
        after = self.effect.advance(self._signals(), now, self._shape)
        return Vectorized([*inputs, *self._shapes], after)

    @property
    def _shape(self) -> dict[str, ca.SX]:
        return {s.name: x for s, x in zip(self.effect.shapes, self._shapes, strict=True)}

    def _signals(self) -> Signals:
        state = {s.name: x for s, x in zip(self.effect.states, self._states, strict=True)}
        other = Signals(**self._other) if self.effect.couples else None
        return Signals(**self._own, other=other, state=state)

    def columns(
        self, signals: SegmentSignals, places: Sequence[tuple[int, int | None]], grid: Array
    ) -> Array:
        """Return the columns (K, places, G, c), not filtered.

        Parameters
        ----------
        places : sequence of (joint, source)
        grid : (G, s)
            Shape parameters.
        """
        own = [signals.values[name][:, [j for j, _ in places], None] for name in OWN]
        other = own
        if self.effect.couples:
            other = [signals.values[name][:, [s or 0 for _, s in places], None] for name in OWN]
        states = self._along(own, grid.T) if self.effect.states else []
        results = self._columns(*own, *other, *grid.T, *states)
        shape = (len(signals.segment), len(places), len(grid))
        return np.stack([np.broadcast_to(x, shape) for x in results], axis=-1)

    def _along(self, own: Sequence[Array], shapes: Array) -> list[Array]:
        """Return the states along a segment, (K, places, G) each."""
        samples, places = own[0].shape[:2]
        states = np.empty((len(self.effect.states), samples, places, shapes.shape[1]))
        for state, series in zip(self.effect.states, states, strict=True):
            series[0] = state.initial
        for k in range(1, samples):
            before, now = (x[k - 1] for x in own), (x[k] for x in own)
            states[:, k] = self._advance(*states[:, k - 1], *before, *now, *shapes)
        return list(states)


def columns_along(
    function: EffectFunction, signals: SegmentSignals, placements: Sequence[Placement], grid: Array
) -> Array:
    """Return filtered columns (M, places, G, c) of one effect in several places."""
    places = [(p.joint, p.source) for p in placements]
    raw = function.columns(signals, places, grid)
    return signals.segment.filter(raw.reshape(len(raw), -1)).reshape(-1, *raw.shape[1:])
