"""Options of the method ``feasible``."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from lieid_casadi.errors import IdentificationError

Range = tuple[float, float]
Three = tuple[float, float, float]


@dataclass(frozen=True, kw_only=True)
class FeasibleOptions:
    """Options of ``identify(..., method="feasible")``. Links and joints count from 0.

    Attributes
    ----------
    total_mass
        Bounds of the total mass of the moving links, kg; equal numbers fix it.
    link_mass
        Bounds of the mass of a link, by its number, kg.
    com_box
        Two corners (3,) of a box in the link frame that contains the centre of mass of a link,
        by its number, m.
    regularization
        Weight λ of the divergence from the nominal bodies, relative to the mean squared error in
        units of the joints' noise; None chooses it by blocked cross-validation.
    margin
        Each pseudo-inertia is at least ``margin`` times that of its reference body.
    velocity
        Speed per joint up to which friction is constrained to dissipate, rad/s. None: the
        velocity limit, or the fastest recorded motion if that is faster or no limit is stated.
    max_iterations
        Of the convex solver.
    poses, seed
        Number of random poses at which the mass matrix is checked, and their seed.

    Raises
    ------
    IdentificationError
        Bounds that contradict each other.
    """

    total_mass: Range | None = None
    link_mass: Mapping[int, Range] = field(default_factory=dict)
    com_box: Mapping[int, tuple[Three, Three]] = field(default_factory=dict)
    regularization: float | None = None
    margin: float = 1e-3
    velocity: Sequence[float] | None = None
    max_iterations: int = 200
    poses: int = 10_000
    seed: int = 0

    def __post_init__(self) -> None:
        if self.total_mass is not None:
            _check_masses("total_mass", self.total_mass)
        for link, masses in self.link_mass.items():
            _check_masses(f"link_mass of link {link} (from 0)", masses)
        for link, (low, high) in self.com_box.items():
            for axis, bounds in zip("xyz", zip(low, high, strict=True), strict=True):
                _check_range(f"com_box of link {link} (from 0), {axis}", bounds, "m")
        for name, number in (
            ("regularization", self.regularization),
            *(("velocity", speed) for speed in self.velocity or ()),
        ):
            if number is not None and not (np.isfinite(number) and number > 0.0):
                raise IdentificationError(f"{name} is {number}, expected a number above 0")
        if not 0.0 < self.margin < 0.5:
            raise IdentificationError(f"margin is {self.margin}, expected above 0 and below 0.5")
        for name, count in (("poses", self.poses), ("max_iterations", self.max_iterations)):
            if count < 1:
                raise IdentificationError(f"{name} is {count}, expected 1 or more")

    def check_links(self, n: int) -> None:
        """Raise `IdentificationError` if an option names a link that does not exist."""
        for name, links in (("link_mass", self.link_mass), ("com_box", self.com_box)):
            for link in links:
                if not 0 <= link < n:
                    raise IdentificationError(f"{name}: link {link}, expected 0 to {n - 1}")
        if self.velocity is not None and len(self.velocity) != n:
            raise IdentificationError(
                f"velocity: {len(self.velocity)} numbers, expected one per joint ({n})"
            )


def _check_range(name: str, bounds: Range, unit: str) -> None:
    low, high = bounds
    if not (np.isfinite(low) and np.isfinite(high)):
        raise IdentificationError(f"{name}: {low:g} to {high:g} {unit}, expected finite numbers")
    if low > high:
        raise IdentificationError(f"{name}: {low:g} to {high:g} {unit}, expected lower ≤ upper")


def _check_masses(name: str, masses: Range) -> None:
    _check_range(name, masses, "kg")
    low, high = masses
    if low < 0.0 or high <= 0.0:
        raise IdentificationError(
            f"{name}: {low:g} to {high:g} kg, expected 0 ≤ lower and upper above 0"
        )
