"""Effects as changes of a model that is not fitted again: what changes together with them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import casadi as ca

from lieid_casadi.effects.effect import Effect, Signals, make

#: An effect that replaces another one, whose column is subtracted.
REPLACES = {"presliding": "coulomb"}
#: An effect that comes with another one: the rest angle of a spring is not a second change.
COMES_WITH = {"position_spring": "offset"}


class IncrementalEffect(Effect):
    """An effect added to a model in place of, or together with, another effect."""

    def __init__(self, effect: Effect, replaced: Effect | None, companion: Effect | None) -> None:
        self.name = effect.name  # type: ignore[misc]
        self.option, self.formula = effect.option, effect.formula
        self.shapes, self.states, self.dry = effect.shapes, effect.states, effect.dry
        self._effect, self._replaced, self._companion = effect, replaced, companion
        others = tuple(other for other in (replaced, companion) if other is not None)
        self.signals = tuple({s for e in (effect, *others) for s in e.signals})
        self.coefficients = effect.coefficients
        if companion is not None:
            self.coefficients += companion.coefficients

    def columns(self, s: Signals, shape: Mapping[str, ca.SX]) -> Sequence[ca.SX]:
        """See the class."""
        own = list(self._effect.columns(s, shape))
        if self._replaced is not None:
            own[0] = own[0] - self._replaced.columns(s, {})[0]
        if self._companion is not None:
            own += self._companion.columns(s, {})
        return own

    def advance(self, before: Signals, now: Signals, shape: Mapping[str, ca.SX]) -> Sequence[ca.SX]:
        """See the class."""
        return self._effect.advance(before, now, shape)


def incremental(effect: Effect, present: Sequence[str]) -> Effect:
    """Return an effect as the change that it makes to a model with the named effects."""
    replaced = REPLACES.get(effect.name)
    companion = COMES_WITH.get(effect.name)
    if replaced not in present and companion is None:
        return effect
    return IncrementalEffect(
        effect,
        make(replaced) if replaced in present and replaced is not None else None,
        make(companion) if companion is not None else None,
    )
