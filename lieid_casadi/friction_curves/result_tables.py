"""Tables of friction curves and of friction models fitted to them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from lieid_casadi.tables import Table, make_table

if TYPE_CHECKING:
    from lieid_casadi.friction_curves.curve import FrictionCurve
    from lieid_casadi.friction_curves.friction_fit import FrictionFit
    from lieid_casadi.friction_curves.ranking import RankedFrictionModel

MOST_ROWS = 30  # of a curve; its JSON has all


def curve_table(curve: FrictionCurve) -> Table:
    """Return the points of a curve over speed, at most `MOST_ROWS` evenly chosen ones."""
    order = sorted(range(len(curve)), key=lambda k: float(curve.speed[k]))
    shown = order[:: max(1, -(-len(curve) // MOST_ROWS))]
    return make_table(
        f"Friction of joint {curve.joint + 1} {curve.joint_name}: half of forward − backward "
        f"(low-pass {curve.cutoff:.3g} Hz, load {curve.load_source}; {len(shown)} of "
        f"{len(curve)} points)",
        ("speed, rad/s", f"load, {curve.unit}", f"friction, {curve.unit}", "std", "passes"),
        [
            (
                float(curve.speed[k]),
                float(curve.load[k]),
                float(curve.friction[k]),
                float(curve.std[k]),
                int(curve.count[k]),
            )
            for k in shown
        ],
    )


def ranking_table(ranked: Sequence[RankedFrictionModel]) -> Table:
    """Return friction models in the order of the Bayesian information criterion (BIC).

    Models are named by their form; an asterisk marks those with a note.
    """
    best, unit = ranked[0].fit.bic, ranked[0].fit.curve.unit
    return make_table(
        "Friction models, by the Bayesian information criterion (BIC)",
        (
            "model",
            f"RMS, {unit}",
            "correlation",
            "BIC above the best",
            "parameters",
            "source (name)",
        ),
        [
            (
                ranked_model.model.form + ("*" if ranked_model.model.note else ""),
                ranked_model.fit.rms,
                f"{ranked_model.fit.correlation:.4f}",
                f"{ranked_model.fit.bic - best:.1f}",
                len(ranked_model.fit.parameters),
                f"{ranked_model.model.credit} ({ranked_model.model.name})",
            )
            for ranked_model in ranked
        ],
    )


def parameter_table(fit: FrictionFit) -> Table:
    """Return the parameters of a friction model fitted to a curve."""
    return make_table(
        f"Joint {fit.curve.joint + 1}, {', '.join(fit.effects)}: RMS {fit.rms:.3g} "
        f"{fit.curve.unit}, correlation {fit.correlation:.4f}",
        ("parameter", "value", "std", "unit"),
        [(row["name"], row["value"], row["std"], row["unit"]) for row in fit.parameter_table()],
    )
