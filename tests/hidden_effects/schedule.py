"""The list of all cases of the benchmark."""

from __future__ import annotations

import hashlib
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from itertools import product

from hidden_effects.case_setup import LATER, SIZES, Case
from hidden_effects.effect_library import CHANGED, MISSING
from hidden_effects.foreign import FOREIGN, FORMS
from hidden_effects.worlds import WORLDS

DRAWS = {"missing": 4, "changed": 2}  # of each effect at each size
SEVERAL = {"pair": 36, "triple": 12, "none": 80}
SIX_DRAWS = 80  # of arms that lack six effects
FOREIGN_SIZES = (5.0, 2.0, 1.0)
FOREIGN_DRAWS, FORM_DRAWS, WORLD_DRAWS = 2, 4, 12  # of each
TIMES = ("0.02s", "0.05s", "0.1s", "0.2s", "0.3s", "0.5s", "1s")  # of empty correlated cases
CORRELATED_DRAWS = {"missing": 12, "changed": 4}
SECOND_ONLY = frozenset(
    ("friction_step", "product_of_other_velocities", "cross_talk", "friction_by_acceleration",
     *(f"bam_m{model}" for model in range(1, 7)))
)  # fmt: skip
KINDS = ("single", "pair", "triple", "six", "none", "correlated", "foreign", "form", "world")
HALVES = ("tune", "sealed")
QUICK = (  # of the tune half: mode, kind, number of cases
    ("missing", "single", 10), ("missing", "pair", 2), ("missing", "none", 1),
    ("missing", "correlated", 4), ("missing", "foreign", 4), ("missing", "form", 3),
    ("missing", "world", 2), ("changed", "single", 3), ("changed", "correlated", 1),
)  # fmt: skip


def cases() -> Iterator[Case]:
    """Yield every case of the benchmark, the first series before the second."""
    for first in (0, LATER):
        for changed in (False, True):
            library, mode = (CHANGED, "changed") if changed else (MISSING, "missing")
            yield from _each("single", library, SIZES, DRAWS[mode], first, changed)
            yield from _each("foreign", FOREIGN, FOREIGN_SIZES, FOREIGN_DRAWS, first, changed)
            for kind, count in SEVERAL.items():
                yield from (Case(kind, first + k, changed) for k in range(count))
            if first:
                count = CORRELATED_DRAWS[mode]
                yield from _each("correlated", TIMES, (0.0,), count, first, changed)
        yield from (Case("six", first + k) for k in range(SIX_DRAWS))
        yield from _each("form", FORMS, FOREIGN_SIZES, FORM_DRAWS, first)
        yield from _each("world", WORLDS, (0.0,), WORLD_DRAWS, first)


def _each(
    kind: str,
    names: Iterable[str],
    sizes: Iterable[float],
    draws: int,
    first: int,
    changed: bool = False,
) -> Iterator[Case]:
    for name, size, draw in product(names, sizes, range(first, first + draws)):
        if first or name not in SECOND_ONLY:
            yield Case(kind, draw, changed, name, size)


def chosen(
    *,
    half: str = "tune",
    modes: Iterable[str] = (),
    kinds: Iterable[str] = (),
    effects: Iterable[str] = (),
    sizes: Iterable[float] = (),
    series: Iterable[int] = (1, 2),
    seed: int = 0,
    skip: int = 0,
    count: int | None = None,
) -> list[Case]:
    """Return the cases of a half, of these modes, kinds, effects and sizes (none stated: all).

    They are in a pseudo-random order that depends on the seed alone, so that the first ones are a
    sample of all, and those that follow the ``skip`` first ones are another sample.
    """
    wanted = [
        case
        for case in cases()
        if case.half == half
        and case.series in series
        and (not modes or ("changed" if case.changed else "missing") in modes)
        and (not kinds or case.kind in kinds)
        and (not effects or case.effect in effects)
        and (not sizes or case.size in sizes)
    ]
    prefix = f"{seed}:" if seed else ""
    wanted.sort(key=lambda case: hashlib.sha256((prefix + case.name).encode()).digest())
    return wanted[skip:][:count]


def quick() -> list[Case]:
    """Return about 30 cases of the tune half, of all kinds, for use during development."""
    return [
        case
        for mode, kind, count in QUICK
        for case in varied(
            chosen(modes=[mode], kinds=[kind], sizes=(5.0, 2.0, 1.0, 0.0), series=[2])
        )[:count]
    ]


def varied(cases: Sequence[Case]) -> list[Case]:
    """Return the cases in an order in which every effect comes once before any comes twice."""
    seen = Counter[tuple[str, bool, str]]()
    turns = []
    for case in cases:
        key = (case.kind, case.changed, case.effect)
        turns.append(seen[key])
        seen[key] += 1
    return [case for _, case in sorted(zip(turns, cases, strict=True), key=lambda pair: pair[0])]
