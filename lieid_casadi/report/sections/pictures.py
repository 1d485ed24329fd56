"""Pictures of a comparison."""

from __future__ import annotations

from typing import TYPE_CHECKING

from lieid_casadi.comparison import Comparison
from lieid_casadi.report.picture import data_uri
from lieid_casadi.report.section import Section

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def torques_section(comparison: Comparison) -> Section:
    """Return measured and predicted torque and the error over time."""
    return picture_section("Torque over time", comparison.plot(), "")


def dependence_section(comparison: Comparison) -> Section:
    """Return the error against the signals it may depend on."""
    note = (
        "Error against position, speed, direction, load and time. Lines that stay on zero: the "
        "model has it. Both directions bent alike: gravity, inertia or a spring. Lines that part "
        "over speed: viscous friction; over load: friction that grows with load; over position: "
        "friction that varies with position."
    )
    return picture_section("What the error follows", comparison.plot_errors(), note)


def picture_section(title: str, figure: Figure, note: str) -> Section:
    """Return a section of one picture."""
    return Section(title, "picture.html", {"uri": data_uri(figure), "alt": title, "note": note})
