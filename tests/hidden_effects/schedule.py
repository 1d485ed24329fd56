"""The list of all cases of the benchmark."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Iterator
from itertools import product

from hidden_effects.case_setup import SIZES, Case
from hidden_effects.effect_library import CHANGED, MISSING
from hidden_effects.foreign import FOREIGN
from hidden_effects.forms import FORMS
from hidden_effects.worlds import WORLDS

DRAWS = {"missing": 4, "changed": 2}  # of each effect at each size
SEVERAL = {"pair": 36, "triple": 12, "none": 80}
FOREIGN_SIZES = (5.0, 2.0, 1.0)
FOREIGN_DRAWS, FORM_DRAWS, WORLD_DRAWS = 2, 4, 12  # of each
KINDS = ("single", "pair", "triple", "none", "foreign", "form", "world")
HALVES = ("tune", "sealed")


def cases() -> Iterator[Case]:
    """Yield every case of the benchmark."""
    for changed in (False, True):
        library, mode = (CHANGED, "changed") if changed else (MISSING, "missing")
        yield from _each("single", library, SIZES, DRAWS[mode], changed=changed)
        yield from _each("foreign", FOREIGN, FOREIGN_SIZES, FOREIGN_DRAWS, changed=changed)
        for kind, count in SEVERAL.items():
            yield from (Case(kind, draw, changed) for draw in range(count))
    yield from _each("form", FORMS, FOREIGN_SIZES, FORM_DRAWS)
    yield from _each("world", WORLDS, (0.0,), WORLD_DRAWS)


def _each(
    kind: str,
    names: Iterable[str],
    sizes: Iterable[float],
    draws: int,
    *,
    changed: bool = False,
) -> Iterator[Case]:
    for name, size, draw in product(names, sizes, range(draws)):
        yield Case(kind, draw, changed, name, size)


def chosen(
    *,
    half: str = "tune",
    modes: Iterable[str] = (),
    kinds: Iterable[str] = (),
    effects: Iterable[str] = (),
    sizes: Iterable[float] = (),
    skip: int = 0,
    limit: int | None = None,
) -> list[Case]:
    """Return the cases of a half, of these modes, kinds, effects and sizes (none stated: all).

    They are in a fixed pseudo-random order, so that the first ones are a sample of all, and those
    that follow the ``skip`` first ones are another sample.
    """
    wanted = [
        case
        for case in cases()
        if case.half == half
        and (not modes or ("changed" if case.changed else "missing") in modes)
        and (not kinds or case.kind in kinds)
        and (not effects or case.effect in effects)
        and (not sizes or case.size in sizes)
    ]
    wanted.sort(key=lambda case: hashlib.sha256(case.name.encode()).digest())
    return wanted[skip:][:limit]
