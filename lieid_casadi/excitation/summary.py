"""Text summary of a design."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from lieid_casadi.tables import html as to_html

if TYPE_CHECKING:
    from lieid_casadi.excitation.excitation import Excitation


def summary(excitation: Excitation) -> str:
    """Return a few paragraphs: quality, reference, active limits, weakest directions."""
    e, q = excitation, excitation.quality
    unit = "SI" if e.scaling == "si" else f"columns scaled by {e.scaling}"
    effects = ", ".join(e.model.effects) or "no effects"
    random = [s.first_condition_number for s in e.starts if np.isfinite(s.first_condition_number)]
    against = ""
    if random:
        against = (
            f" Random starts had {np.median(random):.3g} after one iteration (median of "
            f"{len(random)})."
        )
    lines = [
        f"Excitation of {e.model.robot.name}: {e.duration:.4g} s, of which {e.start:.4g} to "
        f"{e.end:.4g} s are the trajectory ({e.periods} × {e.trajectory.duration:.4g} s).",
        f"Condition number {e.condition_number:.4g} (σ₁ {q.singular_values[0]:.4g}, "
        f"σ_r {q.singular_values[q.rank - 1]:.4g} of the full regressor at {e.samples} samples, "
        f"{unit}, {effects}); −log det {e.neg_log_det:.4g} for {q.rank} base parameters. "
        f"Solved by Ipopt.{against}",
        f"These limits are met on a grid 20 times finer than the samples (largest excess "
        f"{e.max_violation:.1g}): {'; '.join(e.checked)}.",
        f"Not checked: {'; '.join(e.unchecked)}.",
    ]
    if e.active_limits:
        names = ", ".join(limit.quantity for limit in e.active_limits[:6])
        more = f" and {len(e.active_limits) - 6} more" if len(e.active_limits) > 6 else ""
        lines.append(f"Active limits: {names}{more}.")
    weak = "; ".join(f"{w.text} (σ {w.singular_value:.3g})" for w in q.weak)
    lines.append(f"Directions of the base parameters that change the torques least: {weak}.")
    if e.interrupted:
        lines.append("The search was interrupted; this is the best trajectory so far.")
    lines += [f"! {warning}" for warning in e.warnings]
    return "\n".join(lines)


def html(excitation: Excitation) -> str:
    """Return the summary as HTML paragraphs, for notebooks."""
    return to_html(*summary(excitation).split("\n"))
