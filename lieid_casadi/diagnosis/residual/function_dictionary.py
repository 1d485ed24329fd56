"""Dictionary of the sparse regression: simple functions of one signal and products of two."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import combinations, product

import numpy as np
from numpy.typing import NDArray

from lieid_casadi.diagnosis.residual.signal_names import signal_values, split_name
from lieid_casadi.diagnosis.screening.effect_columns import SegmentSignals

Array = NDArray[np.float64]
HARMONICS = 6
SUPERSCRIPTS = str.maketrans("0123456789", "⁰¹²³⁴⁵⁶⁷⁸⁹")


@dataclass(frozen=True)
class SignalFunction:
    """A function of one signal.

    Attributes
    ----------
    text, code : str
        In formulas and in CasADi; ``{x}`` is replaced by the signal, ``{s}`` by the signals of its
        joint.
    power : int
        Exponent of the signal's unit.
    cost : int
        Complexity; of two functions that explain the same, the simpler one is selected.
    of : callable
        (values (K,), sign of the joint's velocity (K,)) → (K,).
    """

    text: str
    code: str
    power: int
    cost: int
    of: Callable[[Array, Array], Array]


def _waves(k: int) -> list[SignalFunction]:
    times, code = ("", "{x}") if k == 1 else (f"{k} ", f"{k} * {{x}}")
    return [
        SignalFunction(f"sin({times}{{x}})", f"ca.sin({code})", 0, k, lambda x, s: np.sin(k * x)),
        SignalFunction(f"cos({times}{{x}})", f"ca.cos({code})", 0, k, lambda x, s: np.cos(k * x)),
    ]


LINE = SignalFunction("{x}", "{x}", 1, 1, lambda x, s: x)
SQUARE = SignalFunction("{x}²", "{x} ** 2", 2, 2, lambda x, s: x**2)
CUBE = SignalFunction("{x}³", "{x} ** 3", 3, 3, lambda x, s: x**3)
SIZE = SignalFunction("|{x}|", "ca.fabs({x})", 1, 2, lambda x, s: np.abs(x))
SIGN = SignalFunction("sgn({x})", "{s}.sign", 0, 1, lambda x, s: s)
SIGNED_SQUARE = SignalFunction("{x}·|{x}|", "{x} * ca.fabs({x})", 2, 2, lambda x, s: x * np.abs(x))
POWERS = [LINE, SQUARE, CUBE]
FUNCTIONS = {
    "q": [f for k in range(1, HARMONICS + 1) for f in _waves(k)],
    "dq": [SIGN, LINE, SIZE, SQUARE, SIGNED_SQUARE, CUBE],
    "ddq": [LINE, SIZE, SQUARE],
    "load": [LINE, SIZE, SQUARE],
    "temp": [LINE, SQUARE],
    "t": [LINE],
}


@dataclass(frozen=True)
class Term:
    """A product of functions of one or two signals.

    Attributes
    ----------
    factors : tuple of (str, SignalFunction)
        Signal and function of each factor.
    """

    factors: tuple[tuple[str, SignalFunction], ...]

    @property
    def text(self) -> str:
        """Such as ``sin(2 q3)·dq1``."""
        return "·".join(f.text.format(x=name) for name, f in self.factors)

    @property
    def cost(self) -> int:
        """Sum of the costs of the factors."""
        return sum(f.cost for _, f in self.factors)

    @property
    def joints(self) -> frozenset[int]:
        """Joints (from 0) whose signals it depends on; time belongs to no joint."""
        return frozenset(split_name(name)[1] for name, _ in self.factors if name != "t")

    def along(self, signals: SegmentSignals) -> Array:
        """Return the values (K,) along a segment, not filtered."""
        values = np.ones(len(signals.segment))
        for name, function in self.factors:
            sign = signals.values["sign"][:, split_name(name)[1]]
            values = values * function.of(signal_values(signals, name), sign)
        return values

    def unit(self, revolute: Sequence[bool], joint: int) -> str:
        """Return the unit of its coefficient in the torque of a joint.

        Parameters
        ----------
        revolute : sequence of bool
            Of each joint: revolute, or prismatic.
        joint : int
            On which the torque acts, from 0.
        """
        torque = "N·m" if revolute[joint] else "N"
        powers: dict[str, int] = {torque: 1}
        for name, function in self.factors:
            kind, source = split_name(name)
            length = "rad" if revolute[source] else "m"
            load = "N·m" if revolute[source] else "N"
            each = {
                "q": {length: 1}, "dq": {length: 1, "s": -1}, "ddq": {length: 1, "s": -2},
                "load": {load: 1}, "temp": {"°C": 1}, "t": {"s": 1},
            }[kind]  # fmt: skip
            for unit, power in each.items():
                powers[unit] = powers.get(unit, 0) - power * function.power
        return _unit_text(powers)


def dictionaries(names: Sequence[str], revolute: Sequence[bool]) -> list[list[Term]]:
    """Return one dictionary with sines and cosines of the angles, and one with their powers.

    The two are not mixed, since a sum of both fits any curve. A torque is either periodic in an
    angle, or that of a spring.

    Parameters
    ----------
    names : sequence of str
        Signals.
    revolute : sequence of bool
        Of each joint.
    """
    periodic = any(split_name(n)[0] == "q" and revolute[split_name(n)[1]] for n in names)
    return [dictionary(names, revolute, waves=w) for w in ((True, False) if periodic else (False,))]


def dictionary(names: Sequence[str], revolute: Sequence[bool], *, waves: bool = True) -> list[Term]:
    """Return the functions of the given signals, and products of functions of two signals.

    Parameters
    ----------
    names : sequence of str
        Signals.
    revolute : sequence of bool
        Of each joint.
    waves : bool
        Whether angles enter by sines and cosines, else by powers.
    """
    functions = {name: _functions(name, revolute, waves) for name in names}
    terms = [Term(((name, f),)) for name in names for f in functions[name]]
    for a, b in combinations(names, 2):
        terms += [Term(((a, f), (b, g))) for f, g in product(functions[a], functions[b])]
    return terms


def _functions(name: str, revolute: Sequence[bool], waves: bool) -> list[SignalFunction]:
    kind, joint = split_name(name)
    if kind == "q" and not (waves and revolute[joint]):
        return POWERS
    return FUNCTIONS[kind]


def _unit_text(powers: dict[str, int]) -> str:
    """Return ``N·m·s²/rad²`` of {N·m: 1, s: 2, rad: −2}."""

    def raised(unit: str, power: int) -> str:
        if power == 1:
            return unit
        return (f"({unit})" if "·" in unit else unit) + str(power).translate(SUPERSCRIPTS)

    def joined(parts: list[tuple[str, int]]) -> str:
        return "·".join(raised(unit, power) for unit, power in parts)

    above = [(unit, power) for unit, power in powers.items() if power > 0]
    below = [(unit, -power) for unit, power in powers.items() if power < 0]
    over = joined(above) or "1"
    if not below:
        return over
    under = joined(below)
    return f"{over}/({under})" if len(below) > 1 else f"{over}/{under}"
