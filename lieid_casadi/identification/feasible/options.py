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
            if not np.all(np.asarray(low, float) <= np.asarray(high, float)):
                raise IdentificationError(
                    f"com_box of link {link} (from 0): {low} to {high}, expected lower ≤ upper"
                )
        if self.regularization is not None and not (
            np.isfinite(self.regularization) and self.regularization > 0.0
        ):
            raise IdentificationError(
                f"regularization is {self.regularization}, expected a number above 0, or None"
            )
        if not 0.0 < self.margin < 0.5:
            raise IdentificationError(f"margin is {self.margin}, expected above 0 and below 0.5")

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


def _check_masses(name: str, masses: Range) -> None:
    low, high = masses
    if not 0.0 <= low <= high or high <= 0.0:
        raise IdentificationError(
            f"{name}: {low:g} to {high:g} kg, expected 0 ≤ lower ≤ upper, upper above 0"
        )
