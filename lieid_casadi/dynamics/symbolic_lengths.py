"""Base parameters with symbols in place of the lengths between the link frames of a robot.

Which columns are kept, and which entries of the combination depend on which lengths, is decided
with numbers, at random lengths. An entry is then the Laurent polynomial of few terms that passes
through its values; further values confirm it.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations_with_replacement as combinations_with
from itertools import pairwise, product
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lieid_casadi.arrays import Array
from lieid_casadi.dynamics.base_parameters import RANK_TOLERANCE, BaseParameters, rounded
from lieid_casadi.errors import ModelError
from lieid_casadi.robot import Robot
from lieid_casadi.robot.inertia import relative

Powers = tuple[tuple[str, int], ...]  # (name of a length, exponent)
Values = Mapping[str, float]  # m, by the name of the length
SUPERSCRIPTS = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")
#: Degrees, in numerator and denominator, that are tried one after another: inertias are moved by
#: squared lengths, and by more where axes do not pass through the origins of their frames.
DEGREES = ((2, 0), (4, 0), (2, 2))
MOST_TERMS = 1000  # that are tried
CONFIRMED = 8  # values beyond those that determine an entry
TOLERANCE = 1e-7  # of an entry, relative to the largest
LEAST_TERM = 1e-6  # smaller coefficients are rounding errors


@dataclass(frozen=True)
class Polynomial:
    """A sum of coefficients times powers of lengths."""

    terms: Mapping[Powers, float]

    def __abs__(self) -> float:
        """Return the largest coefficient in size."""
        return max(abs(value) for value in self.terms.values())

    def at(self, values: Values) -> float:
        """Return the value for given lengths."""
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


def _monomial(powers: Powers, values: Values) -> float:
    return float(np.prod([values[name] ** exponent for name, exponent in powers]))


@dataclass(frozen=True)
class Length:
    """One coordinate of a link's frame in that of the link before, which is not zero.

    ``d3`` is that of link 3; of several they are ``d3x``, ``d3y``, ``d3z``.
    """

    name: str
    joint: int
    axis: int
    value: float  # m

    @property
    def meaning(self) -> str:
        """What it is the length of."""
        parent = f"link {self.joint}" if self.joint else "the base"
        return f"{'xyz'[self.axis]} of the frame of link {self.joint + 1} in that of {parent}"


def lengths_of(robot: Robot) -> tuple[Length, ...]:
    """Return the lengths of a robot; those of the same size have names of their own."""
    found = []
    for i, step in enumerate(_steps(robot)):
        long = [k for k in range(3) if abs(step[k, 3]) > RANK_TOLERANCE]
        found += [
            Length(f"d{i + 1}{'xyz'[k] if len(long) > 1 else ''}", i, k, float(step[k, 3]))
            for k in long
        ]
    return tuple(found)


def _steps(robot: Robot) -> list[Array]:
    """Return the pose (4, 4) of each link frame in that of the link before."""
    homes = [np.eye(4), *(joint.home for joint in robot.joints)]
    return [relative(before, after) for before, after in pairwise(homes)]


def with_lengths(robot: Robot, values: Values) -> Robot:
    """Return the robot with other lengths; its angles, and axes beside link frames, are kept."""
    named = {(length.joint, length.axis): values[length.name] for length in lengths_of(robot)}
    here, joints = np.eye(4), []
    for i, (joint, step) in enumerate(zip(robot.joints, _steps(robot), strict=True)):
        step[:3, 3] = [named.get((i, k), 0.0) for k in range(3)]
        here = here @ step
        rotation, origin = here[:3, :3], here[:3, 3]
        turned = rotation @ joint.axis[:3]
        moved = rotation @ joint.axis[3:] + np.cross(origin, turned)
        joints.append(replace(joint, screw=np.concatenate([turned, moved]), home=here))
    return replace(robot, joints=tuple(joints), source=None)


def symbolic_base(
    robot: Robot, numeric: Callable[[Robot], BaseParameters]
) -> tuple[BaseParameters, tuple[Length, ...]]:
    """Return base parameters whose combination has polynomials, and the lengths in them.

    ``numeric`` returns the base parameters of a robot. Raises `ModelError`: other columns are kept
    with the robot's own lengths than with lengths in general, or entries are no polynomials.
    """
    own = numeric(robot)

    def combination(values: Values) -> Array:
        base = numeric(with_lengths(robot, values))
        if list(base.kept) != list(own.kept):
            raise ModelError(
                f"robot {robot.name!r}: with its own lengths, other base parameters are "
                "identifiable than with lengths in general; expected lieid show without --symbolic"
            )
        return base.combination

    lengths = lengths_of(robot)
    made = _polynomials([length.name for length in lengths], combination, robot.name)
    terms = [powers for x in made.flat if isinstance(x, Polynomial) for powers in x.terms]
    used = {name for powers in terms for name, _ in powers}
    base = replace(own, combination=made)
    return base, tuple(length for length in lengths if length.name in used)


def _polynomials(
    names: Sequence[str], matrix: Callable[[Values], Array], robot: str
) -> NDArray[Any]:
    """Return a matrix that depends on lengths as floats and polynomials."""
    random = np.random.default_rng(0)

    def drawn() -> dict[str, float]:
        return {name: float(random.choice([-1, 1]) * random.uniform(0.4, 1.4)) for name in names}

    start, other = drawn(), drawn()
    first = matrix(start)
    depends = [np.abs(matrix(start | {x: other[x]}) - first) > TOLERANCE for x in names]
    groups: dict[tuple[str, ...], list[tuple[int, ...]]] = {}
    for index in np.argwhere(np.any(depends, axis=0)):
        own = tuple(x for x, each in zip(names, depends, strict=True) if each[tuple(index)])
        groups.setdefault(own, []).append(tuple(map(int, index)))
    made: NDArray[Any] = first.astype(object)
    points, samples = list[Values](), list[Array]()
    for own, places in groups.items():
        for degree, below in DEGREES:
            terms = _terms(own, degree, below)
            while len(points) < len(terms) + CONFIRMED <= MOST_TERMS:
                points.append(drawn())
                samples.append(matrix(points[-1]))
            found = _fitted(terms, points, np.array([[x[p] for p in places] for x in samples]))
            if found is not None:
                break
        else:
            raise ModelError(
                f"base parameters of robot {robot!r}: one that depends on {', '.join(own)} is "
                "no polynomial of low degree; expected lieid show without --symbolic"
            )
        for place, entry in zip(places, found, strict=True):
            made[place] = entry
    return made


def _terms(names: Sequence[str], degree: int, below: int) -> list[Powers]:
    """Return the powers of lengths that an entry may have."""
    above, beneath = (
        [Counter(chosen) for k in range(most + 1) for chosen in combinations_with(names, k)]
        for most in (degree, below)
    )
    return [
        tuple((x, up[x] - down[x]) for x in names if up[x] or down[x])
        for up, down in product(above, beneath)
        if not set(up) & set(down)
    ]


def _fitted(
    terms: Sequence[Powers], points: Sequence[Values], values: Array
) -> list[Polynomial] | None:
    """Return the polynomials through values (K, entries) at points (K); None if there are none."""
    if len(points) < len(terms) + CONFIRMED:
        return None
    matrix = np.array([[_monomial(powers, x) for powers in terms] for x in points])
    rough = np.linalg.lstsq(matrix, values, rcond=None)[0]
    found = []
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
