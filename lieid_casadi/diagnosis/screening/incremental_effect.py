"""Effects as changes to a model whose numbers stay: what else changes together with them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import casadi as ca

from lieid_casadi.effects.effect import Effect, Signals, make

#: Takes the place of another effect, whose column goes as this one's comes.
IN_PLACE_OF = {"presliding": "coulomb"}
#: Comes with another one: a spring has a rest angle, which is no second change.
TOGETHER_WITH = {"position_spring": "offset"}


class AsChange(Effect):
    """An effect that comes to a model in place of, or together with, another one."""

    def __init__(self, effect: Effect, gone: Effect | None, beside: Effect | None) -> None:
        self.name = effect.name  # type: ignore[misc]
        self.option, self.formula = effect.option, effect.formula
        self.shapes, self.states, self.dry = effect.shapes, effect.states, effect.dry
        self._effect, self._gone, self._beside = effect, gone, beside
        others = tuple(other for other in (gone, beside) if other is not None)
        self.signals = tuple({s for e in (effect, *others) for s in e.signals})
        self.coefficients = effect.coefficients
        if beside is not None:
            self.coefficients += beside.coefficients

    def columns(self, s: Signals, shape: Mapping[str, ca.SX]) -> Sequence[ca.SX]:
        """See the class."""
        own = list(self._effect.columns(s, shape))
        if self._gone is not None:
            own[0] = own[0] - self._gone.columns(s, {})[0]
        if self._beside is not None:
            own += self._beside.columns(s, {})
        return own

    def advance(self, before: Signals, now: Signals, shape: Mapping[str, ca.SX]) -> Sequence[ca.SX]:
        """See the class."""
        return self._effect.advance(before, now, shape)


def as_change(effect: Effect, present: Sequence[str]) -> Effect:
    """Return an effect as it would come to a model that has the effects named."""
    gone = IN_PLACE_OF.get(effect.name)
    beside = TOGETHER_WITH.get(effect.name)
    if gone not in present and beside is None:
        return effect
    return AsChange(
        effect,
        make(gone) if gone in present and gone is not None else None,
        make(beside) if beside is not None else None,
    )
