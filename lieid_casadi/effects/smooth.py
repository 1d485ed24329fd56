"""A smooth function of one or two signals, for torque that no other effect describes."""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from itertools import chain, product
from math import prod

import casadi as ca
import numpy as np

from lieid_casadi.arrays import Array
from lieid_casadi.effects.effect import (
    Coefficient,
    Columns,
    DataRange,
    Effect,
    Shape,
    ShapeSymbols,
    Signals,
)
from lieid_casadi.effects.registry import register
from lieid_casadi.errors import EffectError

#: Signal → field of `Signals`, unit, range before any data.
SIGNALS: dict[str, tuple[str, str, float]] = {
    "q": ("q", "rad", 3.0),
    "dq": ("dq", "rad/s", 1.0),
    "ddq": ("ddq", "rad/s²", 10.0),
    "load": ("load", "N·m", 100.0),
    "temp": ("temperature", "°C", 10.0),
}
TORQUE = "tau"  # of another joint: its load and its friction, each in proportion
FADE = 0.1  # of a range: beyond its ends the function falls to zero over this distance
SLOW = 0.1  # of the largest speed: knots of a speed are closer below it
KNOTS, LOAD_KNOTS = 10, 16  # splines of one signal; of the load, at whose zero play is crossed
ODD_KNOTS, EVEN_KNOTS = 10, 6  # splines of the speed that change sign with the velocity, and others
PAIR_KNOTS, FRICTION_KNOTS = 5, 8  # splines of each of two signals; of an angle beside a velocity
GRID, PAIR_GRID = 1000, 40  # points over each of one or two ranges where functions are orthogonal
PAIR_REACH = 1.15  # radius in half ranges that two signals together reach: not their corners
LEAST_ALONE, LEAST_TOGETHER = 1e-6, 5e-4  # part of the variance that a further function adds
LARGEST = 1e4  # end of a range, in units of the signal
ROUNDING = 1e-12  # of the largest: smaller numbers of a combination are zeros (odd and even parts)


@dataclass(frozen=True)
class _Signal:
    """A signal of the effect's own joint, or of the one with this number from 0."""

    name: str
    joint: int | None

    @property
    def signed(self) -> bool:
        """Whether the function may jump where the signal changes its sign."""
        return self.name == "dq"

    @property
    def removed(self) -> bool:
        """Whether the model describes what is linear in it: friction, inertia, a gain."""
        return self.joint is None and self.name in ("dq", "ddq", "load")


@register
class Smooth(Effect):
    """A smooth function of one or two signals: τ = Σ c_k·φ_k(x) or Σ c_k·φ_k(x, y).

    The signals are part of the name: ``smooth/dq:3``, ``smooth/q.dq:3``, ``smooth/dq.q5:4`` (own
    signals without a number, those of another joint with its number). φ_k are cubic B-splines on a
    few knots (of two signals their products, where a velocity is dry and viscous friction that the
    other signal modulates), orthonormal over the range of the training data, so that the root of Σ
    c_k² is the size in N·m. Of the torque of another joint (``smooth/tau5:4``) they are its load,
    its dry and its viscous friction, as where a torque sensor feels two joints. Functions of a
    velocity may jump where it changes its sign. A constant, and what is linear in the joint's own
    velocity with its sign, acceleration or load, are left out: `offset`, `viscous`, `coulomb`,
    `armature` and the inertia describe them. The ends of the range (0.5th and 99.5th percentile)
    are stored with the fit; beyond them the function keeps its value and falls to zero within a
    tenth of the range. Nothing is left out of a ``whole`` function, which is for a model whose own
    parameters are kept.
    """

    name = "smooth"
    finding = ("An additional torque on {joints} is a smooth function of its signals",)
    change = ("A torque on {joints} that depends on its signals has changed",)
    options = {
        "q": "of the joint angle",
        "dq": "of the velocity (the default)",
        "ddq": "of the acceleration",
        "load": "of τ_load",
        "temp": "of the temperature",
        "q.dq": "of angle and velocity; any other two signals likewise, as in smooth/dq.q5, or the "
        "torque of another joint, smooth/tau5: in proportion to its load, dry and viscous friction",
    }
    free_options = orthonormal = True
    candidate = False
    like_uncertain_friction = ("rest",)
    revealed_by = "motion through the whole range of the signals, each at several values of others"
    confused_with = {
        "stribeck": "a function of the velocity contains it; prefer the effect with a name",
        "torque_ripple": "a function of the angle contains ripple of low order",
        "position_spring": "a function of the angle contains the spring",
        "load_friction": "friction that varies with the angle resembles one that varies with load",
    }
    typical = "any; the root of the sum of squares of the coefficients is the RMS over the range"
    references = ("de Boor, A Practical Guide to Splines, 1978",)

    def __init__(self, *, option: str = "", whole: bool = False) -> None:
        self.option, self.whole = option or "dq", whole
        self._signals, self._of_torque = _parsed(self.option), self.option.startswith(TORQUE)
        self.formula = f"Σ c_k·φ_k({', '.join(self.option.split('.'))})"
        self._combination = _combination(
            tuple(s.name for s in self._signals),
            () if whole else tuple(s.removed for s in self._signals),
        )
        count = 3 + whole if self._of_torque else self._combination.shape[1]
        self.coefficients = tuple(
            Coefficient(f"c{k + 1}", "N·m", meaning=f"of the orthonormal function φ_{k + 1}")
            for k in range(count)
        )
        self.shapes = tuple(shape for s in self._signals for shape in _range_of(s))
        used = {SIGNALS[s.name][0] for s in self._signals}
        used |= {"sign"} if any(s.signed for s in self._signals) else set()
        self.signals = tuple(sorted(used))
        self.joints = tuple(sorted({s.joint for s in self._signals if s.joint is not None}))

    def columns(self, s: Signals, shape: ShapeSymbols) -> Columns:
        names, functions = [signal.name for signal in self._signals], list[list[ca.SX]]()
        for signal in self._signals:
            source = s if signal.joint is None else s.joint(signal.joint)
            value = getattr(source, SIGNALS[signal.name][0])
            place, within = _place(signal, value, source.sign, shape)
            if self._of_torque:
                own = [np.sqrt(3) * (2 * place - 1)]  # orthonormal over the range
                if signal.name != "load":
                    own = [source.sign, source.sign * own[0]]
            else:
                own = _basis(signal.name, place, source.sign, names)
            functions.append([within * function for function in own])
        if self._of_torque:
            return [*chain(*functions), ca.SX(1)][: len(self.coefficients)]
        products = ca.vertcat(*(prod(factors, start=ca.SX(1)) for factors in product(*functions)))
        return ca.vertsplit(ca.mtimes(ca.SX(ca.DM(self._combination.T)), products))

    @property
    def parts(self) -> tuple[tuple[str, int | None], ...]:
        """The signals and their joints (from 0), None for its own; of a torque, load and speed."""
        return tuple((s.name, s.joint) for s in self._signals)

    def size_text(self, parameters: Mapping[str, float]) -> str:
        """Return the RMS of the function over the range of its signals."""
        size = np.sqrt(sum(parameters.get(c.name, 0.0) ** 2 for c in self.coefficients))
        return f"{size:.3g} N·m RMS over the range of {' and '.join(self.option.split('.'))}"


def _parsed(option: str) -> tuple[_Signal, ...]:
    """Return the signals of ``dq``, ``q.dq`` or ``dq.q5``; those of ``tau5`` are two."""
    if torque := re.fullmatch(TORQUE + r"([1-9]\d{0,2})", option):
        return tuple(_Signal(name, int(torque[1]) - 1) for name in ("load", "dq"))
    found = [re.fullmatch(r"([a-z]+)([1-9]\d{0,2})?", part) for part in option.split(".")]
    signals = [_Signal(m[1], int(m[2]) - 1 if m[2] else None) for m in found if m]
    known = all(s.name in SIGNALS for s in signals) and len(signals) == len(found)
    if not known or len(signals) > 2 or len(set(signals)) < len(signals):
        raise EffectError(
            f"smooth has no option {option!r}; expected one or two of {', '.join(SIGNALS)}, with "
            "the number of a joint if it is not the effect's own, as in smooth/dq or smooth/dq.q5, "
            f"or the torque of another joint, as in smooth/{TORQUE}5"
        )
    return tuple(signals)


def _range_of(signal: _Signal) -> list[Shape]:
    """Return the shape parameters that hold the range of a signal: its ends, or a top speed."""
    field, unit, reach = SIGNALS[signal.name]
    label = signal.name if signal.joint is None else f"{signal.name}{signal.joint + 1}"
    if signal.signed:
        source = DataRange(field, signal.joint, "size")
        meaning = f"largest |{label}| in the data"
        return [Shape(f"{label}_max", unit, reach, 0.0, LARGEST, meaning=meaning, data=source)]
    return [
        Shape(
            f"{label}_{end}", unit, value, -LARGEST, LARGEST,
            meaning=f"{end} end of {label} in the data", data=DataRange(field, signal.joint, end),
        )
        for end, value in (("low", -reach), ("high", reach))
    ]  # fmt: skip


def _place(signal: _Signal, value: ca.SX, sign: ca.SX, shape: ShapeSymbols) -> tuple[ca.SX, ca.SX]:
    """Return the place of a value in its range, 0 to 1, and the factor that fades beyond it."""
    label = signal.name if signal.joint is None else f"{signal.name}{signal.joint + 1}"
    if signal.signed:
        whole = value * sign / ca.fmax(shape[f"{label}_max"], 1e-9)
    else:
        low, high = shape[f"{label}_low"], shape[f"{label}_high"]
        whole = (value - low) / ca.fmax(high - low, 1e-9)
    place = ca.fmin(ca.fmax(whole, 0), 1)
    beyond = ca.fmin(ca.fabs(whole - place) / FADE, 1)
    return place, 1 - beyond**2 * (3 - 2 * beyond)


def _basis(name: str, place: ca.SX, sign: ca.SX, names: Sequence[str]) -> list[ca.SX]:
    """Return the functions of one of an effect's signals: of its place in its range, and its sign.

    Beside another signal a velocity is dry and viscous friction, which the other one modulates: a
    function of both that is free would extrapolate to speeds that were not seen at its place.
    """
    paired = len(names) > 1
    if name == "dq" and paired:
        return [sign, sign * place]
    if name == "dq":
        warped = ca.log1p(place / SLOW) / np.log1p(1 / SLOW)
        odd, even = _splines(warped, ODD_KNOTS), _splines(warped, EVEN_KNOTS)
        return [*(sign * x for x in odd), *even]
    if name == "q" and "dq" in names:
        return _splines(place, FRICTION_KNOTS)
    alone = LOAD_KNOTS if name == "load" else KNOTS
    return _splines(place, PAIR_KNOTS if paired else alone)


def _splines(place: ca.SX, count: int) -> list[ca.SX]:
    """Return the uniform cubic B-splines on [0, 1], without branches."""
    distance = ca.fabs(place * (count - 3) - ca.DM(range(-1, count - 1)))
    splines = (ca.fmax(2 - distance, 0) ** 3 - 4 * ca.fmax(1 - distance, 0) ** 3) / 6
    return list(ca.vertsplit(splines))


@lru_cache(maxsize=32)
def _combination(names: tuple[str, ...], removed: tuple[bool, ...]) -> Array:
    """Return the combinations (b, c) of products that are orthonormal over the range.

    They are orthogonal to a constant and to what other effects describe, of each signal or, in a
    whole function, of none. Gram and Schmidt's procedure in a fixed order gives the same numbers on
    every machine, which a file with coefficients needs; a singular value decomposition does not.
    """
    paired = len(names) > 1
    count = PAIR_GRID if paired else GRID
    axis = (2.0 * np.arange(count) + 1.0) / count - 1.0
    factors = [_values(axis, name, names) for name in names]
    known = [_described(axis, *each) for each in zip(names, removed, strict=False)]
    known += [np.zeros((count, 0))] * (len(names) - len(known))
    if not paired:
        return _orthonormal(known[0], factors[0], LEAST_ALONE)
    a, b = (x.ravel() for x in np.meshgrid(axis, axis, indexing="ij"))
    near = np.hypot(a, b) <= PAIR_REACH
    ones = np.ones((len(axis), 1))
    sides = [(known[0], ones), (ones, known[1])]
    described, products = (
        np.hstack([np.einsum("ik,jl->ijkl", *s).reshape(len(a), -1) for s in given])[near]
        for given in (sides, [factors])
    )
    return _orthonormal(described, products, LEAST_TOGETHER)


def _orthonormal(known: Array, given: Array, least: float) -> Array:
    """Return combinations (b, c) of given functions: orthonormal, and orthogonal to known ones.

    Functions are values at points (P, b) of equal weight.
    """
    points, count = given.shape
    along = known.T @ given / points
    along[np.abs(along) < ROUNDING * np.abs(given).max()] = 0.0  # by symmetry
    removed = _gram_schmidt(along, np.eye(count), 1e-9) if along.any() else np.zeros((0, count))
    free = np.eye(count) - removed.T @ removed
    return _gram_schmidt(free, given.T @ given / points, least).T


def _gram_schmidt(vectors: Array, metric: Array, least: float) -> Array:
    """Return orthonormal vectors (r, b), without those that add little to the ones before."""
    found: list[Array] = []
    smallest = least * max(float(v @ metric @ v) for v in vectors)
    for vector in vectors:
        rest = vector
        for other in (*found, *found):  # twice, because of rounding
            rest = rest - (other @ metric @ rest) * other
        size = float(rest @ metric @ rest)
        if size > smallest:
            found.append(rest / np.sqrt(size))
    combined = np.array(found)
    return np.where(np.abs(combined) > ROUNDING * np.abs(combined).max(), combined, 0.0)


def _values(axis: Array, name: str, names: Sequence[str]) -> Array:
    """Return the functions of one signal (points, b) along its range, −1 to 1."""
    x = ca.SX.sym("x")
    place = ca.fabs(x) if name == "dq" else (x + 1) / 2
    function = ca.Function("basis", [x], [ca.vertcat(*_basis(name, place, ca.sign(x), names))])
    return np.asarray(function(axis[None]).full().T)


def _described(axis: Array, name: str, removed: bool) -> Array:
    """Return what other effects describe (points, d): a constant, and the linear part."""
    parts = [np.ones_like(axis)]
    if removed:
        parts += [axis, np.sign(axis)] if name == "dq" else [axis]
    return np.column_stack(parts)
