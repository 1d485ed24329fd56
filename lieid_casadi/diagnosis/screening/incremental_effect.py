"""Effects as changes of a model that is not fitted again: what changes together with them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import casadi as ca

from lieid_casadi.effects.effect import Effect
from lieid_casadi.effects.registry import make
from lieid_casadi.effects.signals import Signals


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
        self.coefficients = effect.coefficients
        for companion in companions:
            self.coefficients += companion.coefficients

    def columns(self, s: Signals, shape: Mapping[str, ca.SX]) -> Sequence[ca.SX]:
        """Return the columns of the change."""
        own = list(self._effect.columns(s, shape))
        for replaced in self._replaced:
            own[0] = own[0] - replaced.columns(s, {})[0]
        for companion in self._companions:
            own += companion.columns(s, {})
        return own

    def advance(self, before: Signals, now: Signals, shape: Mapping[str, ca.SX]) -> Sequence[ca.SX]:
        """Return the states of the effect after a step.

        Parameters
        ----------
        before, now : Signals
            At the beginning and at the end of the step; ``before`` contains the states.
        shape : mapping
            Shape parameters by name.
        """
        return self._effect.advance(before, now, shape)


def incremental(effect: Effect, present: Sequence[str]) -> Effect:
    """Return an effect as the change that it makes to a model with the named effects."""
    replaced = [make(name) for name in effect.replaces if name in present]
    companions = [make(name) for name in effect.accompanied_by]
    return IncrementalEffect(effect, replaced, companions) if replaced or companions else effect
