"""Joints whose dry friction reverses later than their velocity."""

from __future__ import annotations

import numpy as np

from lieid_casadi.diagnosis.screening.late_friction import late_friction, p_of_columns
from lieid_casadi.diagnosis.search.search_problem import SearchProblem
from lieid_casadi.errors import LateFrictionWarning

LEAST_OWN_PART = 1e-6  # of a column outside the model


def late_reversals(problem: SearchProblem) -> list[LateFrictionWarning]:
    """Return one warning if dry friction reverses late in the last model, else none.

    It is stated where it is significant and explains as much as an effect must at least.
    """
    context, noise = problem.context, problem.last_noise()
    n, baseline = len(context.runs), problem.current_baseline(noise)
    columns = np.concatenate(context.whitened(noise, late_friction(context, range(n))))
    late = []
    for joint in range(n):
        column = columns[:, [joint]]
        if not column.any():
            continue
        gain = baseline.fall(baseline.with_columns(column))
        delay = float(baseline.coefficients(column, least=LEAST_OWN_PART)[0])
        worth = gain >= problem.least_gain * int(np.diff(baseline.ends)[joint])
        p = n * p_of_columns(baseline, column, n)
        if worth and delay > 0.0 and p <= problem.options.significance:
            late.append(f"joint {joint + 1} ({1e3 * delay:.2g} ms)")
    if not late:
        return []
    return [
        LateFrictionWarning(
            f"dry friction reverses later than the velocity: {', '.join(late)}. A joint may stick "
            "for a moment at reversals, or its torque signal may be delayed; only fast changes of "
            "torque away from reversals distinguish the two"
        )
    ]
