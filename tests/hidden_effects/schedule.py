"""The list of all cases of the benchmark."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Iterator

from hidden_effects.case_setup import SIZES, Case
from hidden_effects.effect_library import CHANGED, MISSING
from hidden_effects.foreign import FOREIGN

DRAWS = {"missing": 4, "changed": 2}  # of each effect at each size
SEVERAL = {
    "missing": {"pair": 36, "triple": 12, "none": 210},
    "changed": {"pair": 36, "triple": 12, "none": 210},
}
FOREIGN_SIZES = (5.0, 2.0, 1.0)
KINDS = ("single", "pair", "triple", "none", "foreign")


def cases() -> Iterator[Case]:
    """Yield every case of the benchmark."""
    for mode, several in SEVERAL.items():
        changed = mode == "changed"
        for effect in CHANGED if changed else MISSING:
            for size in SIZES:
                for draw in range(DRAWS[mode]):
                    yield Case("single", draw, changed, effect, size)
        for kind, count in several.items():
            for draw in range(count):
                yield Case(kind, draw, changed)
        for effect in FOREIGN:
            for size in FOREIGN_SIZES:
                yield Case("foreign", 0, changed, effect, size)


def chosen(
    *,
    modes: Iterable[str] = (),
    kinds: Iterable[str] = (),
    effects: Iterable[str] = (),
    sizes: Iterable[float] = (),
    limit: int | None = None,
) -> list[Case]:
    """Return the cases of these modes, kinds, effects and sizes (all if none are stated).

    They are in a fixed pseudo-random order, so that the first ones are a sample of all.
    """
    wanted = [
        case
        for case in cases()
        if (not modes or ("changed" if case.changed else "missing") in modes)
        and (not kinds or case.kind in kinds)
        and (not effects or case.effect in effects)
        and (not sizes or case.size in sizes)
    ]
    wanted.sort(key=lambda case: hashlib.sha256(case.name.encode()).digest())
    return wanted[:limit]
