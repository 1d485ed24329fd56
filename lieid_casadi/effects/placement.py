"""Which effect acts on which joints: ``coulomb,load_friction:2+3,transmission_coupling:5<6``."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from lieid_casadi.effects.effect import Effect
from lieid_casadi.effects.registry import make
from lieid_casadi.errors import EffectError


@dataclass(frozen=True)
class Placement:
    """An effect on one joint (from 0); for couplings, ``source`` is the joint that causes it."""

    effect: Effect
    joint: int
    source: int | None = None

    @property
    def whole_arm(self) -> bool:
        """Whether the effect acts on no joint in particular."""
        return self.effect.whole_arm

    @property
    def label(self) -> str:
        """The effect as written in files: ``stribeck:4`` (joints from 1)."""
        if self.whole_arm:
            return self.effect.label
        acting = "" if self.source is None else f"<{self.source + 1}"
        return f"{self.effect.label}:{self.joint + 1}{acting}"


def place(spec: str | Effect, n: int, joints: Sequence[int] | None = None) -> list[Placement]:
    """Return the placements of one effect, ``name[:J[+J…]]`` (from 1), on an arm of n joints.

    ``joints`` (from 0) are for an effect without joints; None means every joint. An `EffectError`
    names an unknown effect, a joint that the arm does not have, a coupling without its source.
    """
    if isinstance(spec, Effect):
        if spec.whole_arm:
            return [Placement(spec, 0)]
        return [_placement(spec, j, None, n, spec.label) for j in _every(joints, n)]
    label, _, where = spec.strip().partition(":")
    effect = make(label)
    if effect.whole_arm:
        if where:
            raise EffectError(f"effect {spec!r} acts on the whole arm; leave out its joints")
        return [Placement(effect, 0)]
    if not where:
        return [_placement(effect, j, None, n, spec) for j in _every(joints, n)]
    if joints is not None:
        raise EffectError(f"{spec!r} names joints already; leave out joints=")
    return [_placement(effect, *_joints(part, spec), n, spec) for part in where.split("+")]


def parse_effects(text: str | Iterable[str | Effect], n: int) -> tuple[Placement, ...]:
    """Return the placements of a comma-separated list, or of a sequence of specs."""
    specs = text.split(",") if isinstance(text, str) else list(text)
    placed: list[Placement] = []
    for spec in specs:
        if isinstance(spec, str) and not spec.strip():
            continue
        for placement in place(spec, n):
            if any(placement.label == other.label for other in placed):
                raise EffectError(f"effect {placement.label} is given twice")
            placed.append(placement)
    return tuple(placed)


def labels(placements: Iterable[Placement], n: int) -> list[str]:
    """Return the shortest specs that give these placements: ``coulomb``, ``stribeck:4+5``."""
    specs: dict[str, list[str]] = {}
    everywhere = [str(j + 1) for j in range(n)]
    for placement in placements:
        name, _, where = placement.label.partition(":")
        if placement.whole_arm:
            specs[name] = everywhere
            continue
        specs.setdefault(name, []).append(where)
    return [name if at == everywhere else f"{name}:{'+'.join(at)}" for name, at in specs.items()]


def _every(joints: Sequence[int] | None, n: int) -> Sequence[int]:
    return range(n) if joints is None else joints


def _joints(part: str, spec: str) -> tuple[int, int | None]:
    target, acts, source = part.partition("<")
    try:
        return int(target) - 1, int(source) - 1 if acts else None
    except ValueError:
        raise EffectError(
            f"effect {spec!r}: {part!r} is not a joint; expected e.g. stribeck:2+3 or "
            "transmission_coupling:5<6"
        ) from None


def _placement(effect: Effect, joint: int, source: int | None, n: int, spec: object) -> Placement:
    for j in (joint, source, *effect.joints):
        if j is not None and not 0 <= j < n:
            raise EffectError(f"effect {str(spec)!r}: no joint {j + 1}; the arm has 1 to {n}")
    if joint in effect.joints:
        raise EffectError(
            f"effect {str(spec)!r}: leave out the number {joint + 1} of the effect's own joint"
        )
    if effect.couples and (source is None or source == joint):
        raise EffectError(f"effect {str(spec)!r} couples two joints; write e.g. {effect.name}:5<6")
    if not effect.couples and source is not None:
        raise EffectError(f"effect {str(spec)!r} acts on one joint; leave out '<'")
    return Placement(effect, joint, source)
