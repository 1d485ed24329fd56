"""Base parameters as polynomials: symbols in place of lengths and angles of a robot's geometry.

Which columns are kept, and which entries of the combination depend on which symbols, is decided
with numbers, at random values of the symbols. An entry is then the Laurent polynomial of few terms
that passes through its values; further values confirm it.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from lieid_casadi.dynamics.null_space import RANK_TOLERANCE, rounded
from lieid_casadi.errors import ModelError
from lieid_casadi.robot import Robot
from lieid_casadi.robot.geometry import Geometry, relative

Matrix = NDArray[Any]
Powers = tuple[tuple[str, int], ...]  # (name, exponent); names such as d3 and cos(twist)
Values = Mapping[str, Any]  # numbers, or SX, of the symbols
SUPERSCRIPTS = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")
#: Degrees of lengths, in numerator and denominator, that are tried one after another: inertias are
#: moved by squared lengths, and by more where axes do not pass through the origins of their frames.
DEGREES = ((2, 0), (4, 0), (2, 2))
MOST_TERMS = 1000  # that are tried
CONFIRMED = 8  # values beyond those that determine an entry
TOLERANCE = 1e-7  # of an entry, relative to the largest
LEAST_TERM = 1e-6  # smaller coefficients are rounding errors


@dataclass(frozen=True)
class Polynomial:
    """A sum of coefficients times powers of symbols, and of their cosines and sines."""

    terms: Mapping[Powers, float]

    def __abs__(self) -> float:
        """Return the largest coefficient in size."""
        return max(abs(value) for value in self.terms.values())

    def at(self, values: Values) -> Any:
        """Return the value for given symbols, numbers or SX."""
        return sum(factor * _monomial(powers, values) for powers, factor in self.terms.items())

    def text(self, *, digits: int = 6) -> tuple[str, str]:
        """Return the sign of the first term, and the polynomial without it: ``-``, ``2 d3²``."""
        ordered = sorted(self.terms.items())
        negative = ordered[0][1] < 0
        words = []
        for powers, value in ordered:
            size = f"{abs(value):.{digits}g}"
            letters = [
                name + (str(e).translate(SUPERSCRIPTS) if e != 1 else "") for name, e in powers
            ]
            factors = letters if size == "1" and letters else [size, *letters]
            words.append(f"{'+' if (value < 0) == negative else '-'} {' '.join(factors)}")
        joined = " ".join(words).removeprefix("+ ")
        return "-" if negative else "+", joined if len(words) == 1 else f"({joined})"


def _monomial(powers: Powers, values: Values) -> Any:
    made: Any = 1.0
    for name, exponent in powers:
        made = made * _value(name, values) ** exponent
    return made


def _value(name: str, values: Values) -> Any:
    """Return the value of a symbol, or of the cosine or sine of one."""
    function, _, symbol = name.rpartition("(")
    return getattr(ca, function)(values[symbol[:-1]]) if function else values[name]


def polynomials(robot: Robot, numeric: Callable[[Robot], Matrix]) -> Matrix:
    """Return a matrix that depends on a robot's geometry as floats and polynomials.

    ``numeric`` returns it for the robot with numbers in place of its symbols.
    Raises `ModelError`: an entry is no polynomial of low degree.
    """
    random, names = np.random.default_rng(0), [str(symbol) for symbol in robot.symbols]

    def drawn() -> dict[str, float]:
        return {name: float(random.choice([-1, 1]) * random.uniform(0.4, 1.4)) for name in names}

    start, other = drawn(), drawn()
    first = numeric(robot.with_values(start))
    angles = {x for x in names if _is_periodic(robot, start, x)}
    depends = [
        np.abs(numeric(robot.with_values(start | {x: other[x]})) - first) > TOLERANCE for x in names
    ]
    groups: dict[tuple[str, ...], list[tuple[int, ...]]] = {}
    for index in np.argwhere(np.any(depends, axis=0)):
        own = tuple(x for x, each in zip(names, depends, strict=True) if each[tuple(index)])
        groups.setdefault(own, []).append(tuple(map(int, index)))
    made, points, samples = first.astype(object), list[dict[str, float]](), list[Matrix]()
    for own, places in groups.items():
        for degree, below in DEGREES:
            terms = _terms(own, angles, degree, below)
            while len(points) < len(terms) + CONFIRMED <= MOST_TERMS:
                points.append(drawn())
                samples.append(numeric(robot.with_values(points[-1])))
            found = _fitted(terms, points, np.array([[x[p] for p in places] for x in samples]))
            if found is not None:
                break
        else:
            raise ModelError(
                f"base parameters of robot {robot.name!r}: one that depends on {', '.join(own)} is "
                "no polynomial of low degree; expected lengths and angles whose base parameters "
                "are polynomials (one symbol in place of a sum), or numbers, robot.with_values"
            )
        for place, entry in zip(places, found, strict=True):
            made[place] = entry
    return made


def _is_periodic(robot: Robot, values: Mapping[str, float], name: str) -> bool:
    """Whether a symbol is an angle: the geometry has its cosine and sine alone."""
    turned = robot.with_values({**values, name: values[name] + 2.0 * np.pi})
    same = robot.with_values(values)
    return all(
        np.allclose(a.screw, b.screw, atol=1e-9) and np.allclose(a.home, b.home, atol=1e-9)
        for a, b in zip(turned.joints, same.joints, strict=True)
    ) and np.allclose(turned.gravity, same.gravity)


def _terms(names: Sequence[str], angles: set[str], degree: int, below: int) -> list[Powers]:
    """Return the powers of symbols that an entry may have; cosines and sines are independent."""
    choices: list[list[Powers]] = []
    for name in names:
        c, s = f"cos({name})", f"sin({name})"
        exponents = [(a, b) for b in (0, 1) for a in range(-below, degree + 1 - b)]
        exponents += [(a, b) for b in range(-below, 0) for a in (0, 1)]
        turned = [tuple((x, e) for x, e in ((c, a), (s, b)) if e) for a, b in exponents]
        lengths: list[Powers] = [((name, e),) if e else () for e in range(-below, degree + 1)]
        choices.append(turned if name in angles else lengths)
    found: list[Powers] = [()]
    for own in choices:  # of the products, those of too high a degree are left out at once
        products = (before + each for before in found for each in own)
        found = [powers for powers in products if _is_low(powers, degree, below)]
    return found


def _is_low(powers: Powers, degree: int, below: int) -> bool:
    lengths = [e for name, e in powers if "(" not in name]
    high, low = sum(e for e in lengths if e > 0), -sum(e for e in lengths if e < 0)
    return high <= degree and low <= below


def _fitted(
    terms: Sequence[Powers], points: Sequence[Values], values: Matrix
) -> list[float | Polynomial] | None:
    """Return the polynomials through values (K, entries) at points (K); None if there are none."""
    if len(points) < len(terms) + CONFIRMED:
        return None
    matrix = np.array([[float(_monomial(powers, x)) for powers in terms] for x in points])
    rough = np.linalg.lstsq(matrix, values, rcond=None)[0]
    found: list[float | Polynomial] = []
    for factors, column in zip(rough.T, values.T, strict=True):
        used = np.flatnonzero(np.abs(factors) > LEAST_TERM)
        exact = rounded(np.linalg.lstsq(matrix[:, used], column, rcond=None)[0], 1e-9)
        misfit = np.abs(matrix[:, used] @ exact - column).max()
        if not len(used) or misfit > TOLERANCE * max(1.0, np.abs(column).max()):
            return None
        found.append(
            Polynomial({terms[int(k)]: float(x) for k, x in zip(used, exact, strict=True)})
        )
    return found


@dataclass(frozen=True, eq=False)
class SymbolicLengths:
    """A robot with symbols for its lengths.

    Attributes
    ----------
    robot : Robot
        Its translations between link frames are symbols.
    values : dict
        Name of each symbol → the robot's own length, m.
    places : dict
        Name of each symbol → what it is the length of.
    """

    robot: Robot
    values: dict[str, float]
    places: dict[str, str]


def symbolic_lengths(robot: Robot) -> SymbolicLengths:
    """Return the robot with a symbol for each length that is not zero.

    ``d3`` is the one coordinate of link 3's frame in that of link 2 that is not zero; of several
    they are ``d3x``, ``d3y``, ``d3z``. Lengths of the same size have symbols of their own. Angles,
    and the place of an axis that does not pass through its link frame's origin, stay numbers.
    """
    values: dict[str, float] = {}
    places: dict[str, str] = {}
    before: Geometry = np.eye(4)
    here: Geometry = np.eye(4).astype(object)
    joints = []
    for i, joint in enumerate(robot.joints, start=1):
        step = relative(before, joint.home).astype(object)
        parent = f"link {i - 1}" if i > 1 else "the base"
        long = [k for k in range(3) if abs(step[k, 3]) > RANK_TOLERANCE]
        for k in range(3):
            length, name = step[k, 3], f"d{i}{'xyz'[k] if len(long) > 1 else ''}"
            step[k, 3] = ca.SX.sym(name) if k in long else 0.0
            if k in long:
                values[name] = length
                places[name] = f"{'xyz'[k]} of the frame of link {i} in that of {parent}"
        here, before = here @ step, joint.home
        omega, v = joint.axis[:3], joint.axis[3:]
        rotation, origin = here[:3, :3], here[:3, 3]
        turned = rotation @ omega
        screw = np.concatenate([turned, rotation @ v + np.cross(origin, turned)])
        joints.append(replace(joint, screw=screw, home=here))
    return SymbolicLengths(replace(robot, joints=tuple(joints), source=None), values, places)
