"""Effects as changes of a model that is not fitted again."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import casadi as ca

from lieid_casadi.effects.effect import Effect, Signals
from lieid_casadi.effects.payload import AddedPayload, Payload
from lieid_casadi.effects.registry import make


class IncrementalEffect(Effect):
    """An effect added to a model in place of, or together with, another effect."""

    def __init__(
        self, effect: Effect, replaced: Sequence[Effect], companions: Sequence[Effect]
    ) -> None:
        self.name = effect.name  # type: ignore[misc]
        self.option, self.formula = effect.option, effect.formula
        self.shapes, self.states, self.dry = effect.shapes, effect.states, effect.dry
        self._effect, self._replaced, self._companions = effect, replaced, companions
        every = (effect, *replaced, *companions)
        self.signals = tuple({signal for each in every for signal in each.signals})
        self.coefficients = sum((c.coefficients for c in companions), effect.coefficients)

    def columns(self, s: Signals, shape: Mapping[str, ca.SX]) -> Sequence[ca.SX]:
        """Return the columns of the change."""
        own = list(self._effect.columns(s, shape))
        for replaced in self._replaced:
            own[0] = own[0] - replaced.columns(s, {})[0]
        return own + [c for each in self._companions for c in each.columns(s, {})]

    def advance(self, before: Signals, now: Signals, shape: Mapping[str, ca.SX]) -> Sequence[ca.SX]:
        """Return the states after a step; ``before`` contains those at its beginning."""
        return self._effect.advance(before, now, shape)


def incremental(effect: Effect, present: Sequence[str]) -> Effect:
    """Return an effect as the change that it makes to a model with the named effects."""
    replaced = [make(name) for name in effect.replaces if name in present]
    companions = [make(name) for name in effect.accompanied_by]
    if isinstance(effect, Payload):
        return AddedPayload()
    return IncrementalEffect(effect, replaced, companions) if replaced or companions else effect
