"""The registry of all effects by name, and effects from functions."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from difflib import get_close_matches
from functools import lru_cache

import casadi as ca

from lieid_casadi.effects.effect import Coefficient, Effect, Shape, Signals
from lieid_casadi.errors import EffectError


@dataclass(frozen=True)
class EffectVariant:
    """An effect class with one of its options; calling it makes the effect."""

    kind: type[Effect]
    option: str

    def __call__(self) -> Effect:
        """Return a new effect."""
        return self.kind(option=self.option) if self.option else self.kind()


#: Every registered effect by its label, ``name`` or ``name/option``.
REGISTER: dict[str, EffectVariant] = {}


def register(kind: type[Effect]) -> type[Effect]:
    """Register an effect class under its name, and under ``name/option`` for each option.

    Parameters
    ----------
    kind : type of Effect
        Returned unchanged, so that this is a decorator.

    Raises
    ------
    EffectError
        If the name is taken by another effect.
    """
    for option in ("", *kind.options):
        label = f"{kind.name}/{option}" if option else kind.name
        taken = REGISTER.get(label)
        if taken is not None and taken.kind is not kind:
            raise EffectError(f"effect name {label!r} is taken; choose another name")
        REGISTER[label] = EffectVariant(kind, option)
    return kind


def effect(
    name: str,
    *,
    formula: str,
    coefficients: Mapping[str, str],
    shapes: Sequence[Shape] = (),
    signals: Sequence[str] = ("q", "dq", "sign"),
    couples: bool = False,
) -> Callable[[Callable[..., Sequence[ca.SX]]], type[Effect]]:
    """Register a function ``columns(signals, shape)`` as an effect.

    Parameters
    ----------
    name, formula : str
    coefficients : mapping
        Linear coefficient → unit, in the order of the returned columns.
    shapes : sequence of Shape
        Shape parameters; the function receives their symbols by name.
    signals : sequence of str
        The fields of `Signals` that the function uses.
    couples : bool
        Whether another joint acts on this one: its signals are ``signals.other``, and the effect
        is placed on pairs, ``name:5<6``.

    Examples
    --------
    >>> import casadi as ca
    >>> @effect("cogging6", formula="a·sin(6q)", coefficients={"a": "N·m"}, signals=["q"])
    ... def cogging(s, shape):
    ...     return [ca.sin(6 * s.q)]
    >>> make("cogging6")
    <effect cogging6: a·sin(6q)>
    >>> del REGISTER["cogging6"]
    """

    def wrap(function: Callable[..., Sequence[ca.SX]]) -> type[Effect]:
        members = {
            "__doc__": function.__doc__,
            "name": name,
            "formula": formula,
            "coefficients": tuple(Coefficient(key, unit) for key, unit in coefficients.items()),
            "shapes": tuple(shapes),
            "signals": tuple(signals),
            "couples": couples,
            "columns": lambda self, s, shape: function(s, shape),
        }
        return register(type(name, (Effect,), members))

    return wrap


Library = Mapping[str, EffectVariant]


def usable(library: Library) -> tuple[dict[str, Effect], dict[str, str]]:
    """Return the effects of a library by label, and what is wrong with those that cannot be used.

    A search tries every effect of the library. One whose code raises is left out of it.
    """
    effects, broken = _tried(tuple(library.items()))
    return dict(effects), dict(broken)


@lru_cache(maxsize=4)
def _tried(
    library: tuple[tuple[str, EffectVariant], ...],
) -> tuple[dict[str, Effect], dict[str, str]]:
    effects: dict[str, Effect] = {}
    broken: dict[str, str] = {}
    zero = ca.SX(0)
    other = Signals(zero, zero, zero, zero, zero, zero, zero)
    for label, variant in library:
        try:
            made = variant()
            s = replace(
                other, other=other, state=dict.fromkeys((x.name for x in made.states), zero)
            )
            made.columns(s, dict.fromkeys((x.name for x in made.shapes), ca.SX(1)))
        except Exception as error:  # noqa: BLE001  # whatever a user's code raises
            broken[label] = f"effect {label}: its code raises {type(error).__name__}: {error}"
        else:
            effects[label] = made
    return effects, broken


def make(label: str) -> Effect:
    """Return the effect of a name or ``name/option``.

    Raises
    ------
    EffectError
        If no effect has that name; the message states similar names.
    """
    name, _, option = label.partition("/")
    if option and name in REGISTER and REGISTER[name].kind.free_options:
        return REGISTER[name].kind(option=option)
    if label not in REGISTER:
        similar = get_close_matches(label, sorted(REGISTER), n=3)
        name = f"{', '.join(similar)} or another name" if similar else "a name"
        raise EffectError(
            f"unknown effect {label!r}; expected {name} that lieid effects lists, or the file of a "
            "user-defined effect (--effects-file)"
        )
    return REGISTER[label]()
