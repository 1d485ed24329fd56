"""What a search for missing effects accepted, turned down, or is about to accept."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lieid_casadi.diagnosis.screening.candidates import Candidate
from lieid_casadi.identification import Fit

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Found:
    """One accepted effect.

    Attributes
    ----------
    candidate : Candidate
    fit : Fit
        After a joint refit with it.
    log10_p : float
        Family-wise, over everything that was tried.
    gain : float
        Fall of the whitened residual's sum of squares, in units of the noise's variance.
    cross_validated : (n,)
        Held-out error per joint before and after, N·m: (2, n).
    confirmed : bool or None
        Whether the test's error fell; None without a test.
    rivals : tuple of (Candidate, kind)
    """

    candidate: Candidate
    fit: Fit
    log10_p: float
    gain: float
    effective_rows: int
    cross_validated: Array
    confirmed: bool | None
    rivals: tuple[tuple[Candidate, str], ...]


@dataclass(frozen=True)
class Rejected:
    """A candidate that looked best and was not accepted, and why."""

    candidate: Candidate
    reason: str


@dataclass(frozen=True)
class Proposal:
    """A step that is about to be accepted; ``joint`` (from 0) is where the error falls most.

    ``before`` and ``after`` are held-out errors there, N·m.
    """

    label: str
    joint: int
    before: float
    after: float
