"""Whether the fall of the held-out error is large enough to be a finding."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from lieid_casadi.diagnosis.options import DiagnosisOptions
from lieid_casadi.diagnosis.screening.candidates import Candidate
from lieid_casadi.diagnosis.screening.held_out import HeldOut
from lieid_casadi.diagnosis.search.search_problem import joint_of
from lieid_casadi.diagnosis.wording import small_fall
from lieid_casadi.identification.uncertainty.noise_model import Noise

Array = NDArray[np.float64]


def below_worth(
    candidate: Candidate, held_out: HeldOut, noise: Sequence[Noise], options: DiagnosisOptions
) -> str:
    """Return why the fall of the held-out error is too small, or an empty text.

    Parameters
    ----------
    candidate : Candidate
    held_out : HeldOut
    noise : sequence of Noise
        Of each joint.
    options : DiagnosisOptions
    """
    fall = float(held_out.fall[joint_of(candidate, held_out.fall)])
    if fall < options.worth:
        return f"the held-out error {small_fall(fall)}"
    before, after = (_mean_square(errors, noise) for errors in (held_out.before, held_out.after))
    on_all = 1.0 - after / before
    if candidate.reaches_all and on_all < options.worth_all_joints:
        return f"the mean square error of all joints {small_fall(on_all)}"
    return ""


def _mean_square(errors: Array, noise: Sequence[Noise]) -> float:
    """Return the mean square of errors (n,) relative to the joints' noise."""
    return float(np.nanmean([(e / n.spread) ** 2 for e, n in zip(errors, noise, strict=True)]))
