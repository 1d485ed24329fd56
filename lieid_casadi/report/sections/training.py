"""How the model was fitted."""

from __future__ import annotations

from lieid_casadi.comparison.table import digits
from lieid_casadi.identification import Fit
from lieid_casadi.report.section import Section, table_section
from lieid_casadi.tables import make_table


def training_section(fit: Fit) -> Section:
    """Return the errors of training and cross-validation, and the conditioning of the fit."""
    columns = (fit.rms_cv, fit.rms_train, fit.rms_train_raw)
    table = make_table(
        "",
        ("joint", "cross-validated, in motion", "all", "raw", "unit"),
        [
            (
                f"{j + 1} {joint.name}",
                *(digits(values[j]) for values in columns),
                "N·m" if joint.revolute else "N",
            )
            for j, joint in enumerate(fit.model.robot.joints)
        ],
        note="Cross-validated: on blocks left out of the fit, joints in motion. "
        "All, raw: errors of training.",
    )
    facts = [
        ("effects", ", ".join(fit.model.effects) or "none"),
        ("method", fit.method),
        ("base parameters", str(fit.model.base.count)),
        ("condition number", f"{fit.conditioning.condition_number:.3g}"),
        ("physically consistent", "yes" if fit.physically_consistent else "no"),
    ]
    return table_section("Training", table, facts=facts)
