"""Random search for the best of the motions within limits."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lieid_casadi.discrimination.feasible_motions import FeasibleMotions

Array = NDArray[np.float64]
GROWTH = 1.5  # of the step after a success
INITIAL_STEP, SMALLEST_STEP = 0.3, 1e-3  # relative to the RMS of z


@dataclass(frozen=True, eq=False)
class SearchedMotion:
    """The best motion that a search found.

    Attributes
    ----------
    z : (m,)
    value : float
        Of the criterion.
    evaluations : int
    interrupted : bool
        Whether Ctrl-C ended the search.
    """

    z: Array
    value: float
    evaluations: int
    interrupted: bool = False


def random_search(
    criterion: Callable[[Array], float],
    feasible: FeasibleMotions,
    start: Array,
    *,
    evaluations: int,
    random: np.random.Generator,
) -> SearchedMotion:
    """Improve a motion by random steps; Ctrl-C keeps the best motion so far.

    A (1+1) evolution strategy with the one-fifth rule (Rechenberg 1973). A step of all joints or
    of one joint is kept if the criterion increases. Steps grow after a success and shrink after a
    failure. They are reset once they are small, since a criterion that is the minimum over
    several pairs has ridges, on which steps shrink without convergence. The optimum is local.

    Parameters
    ----------
    criterion : callable
        To be maximized, of z (m,).
    feasible : FeasibleMotions
    start : (m,)
    evaluations : int
        Of the criterion.
    random : numpy.random.Generator
    """
    n = feasible.parametrization.n
    best, highest, step = start, -np.inf, INITIAL_STEP
    used = 0
    try:
        highest = criterion(start)
        used = 1
        while used < evaluations:
            move = random.standard_normal((n, len(best) // n))
            if n > 1 and random.random() < 0.5:
                only = np.zeros((n, 1))
                only[random.integers(n)] = 1.0
                move = move * only
            size = np.sqrt(np.mean(best**2))
            z = feasible.within(best + step * size * np.ravel(move))
            reached = criterion(z)
            used += 1
            if reached > highest:
                best, highest, step = z, reached, min(step * GROWTH, 1.0)
            else:
                step = step * GROWTH**-0.25 if step > SMALLEST_STEP else INITIAL_STEP
    except KeyboardInterrupt:
        return SearchedMotion(best, highest, used, interrupted=True)
    return SearchedMotion(best, highest, used)


def best_starts(values: Sequence[float], count: int) -> list[int]:
    """Return the indices of the largest values, largest first."""
    return [int(k) for k in np.argsort(values)[::-1][:count]]
