"""How the model was fitted."""

from __future__ import annotations

from typing import Any

from lieid_casadi.comparison.table import digits
from lieid_casadi.identification import Fit
from lieid_casadi.report.section import Section


def training_section(fit: Fit) -> Section:
    """Return the errors of training and cross-validation, and what the data determined."""
    condition = fit.conditioning.condition_number
    columns = (
        ("RMS", fit.rms_train),
        ("cross-validated", fit.rms_cv),
        ("raw", fit.rms_train_raw),
    )
    joints = fit.model.robot.joints
    data: dict[str, Any] = {
        "facts": [
            ("effects", ", ".join(fit.model.effects) or "none"),
            ("method", fit.method),
            ("base parameters", str(fit.model.base.count)),
            ("condition number", f"{condition:.3g}"),
            ("physically consistent", "yes" if fit.physically_consistent else "no"),
        ],
        "headings": ("joint", *(heading for heading, _ in columns), "unit"),
        "rows": [
            (
                f"{j + 1} {joint.name}",
                *(digits(values[j]) for _, values in columns),
                "N·m" if joint.revolute else "N",
            )
            for j, joint in enumerate(joints)
        ],
    }
    return Section("Training", "training.html", data)
