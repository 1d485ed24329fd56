"""Figures of a comparison."""

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
    """Return the error over the signals on which it may depend."""
    note = (
        "Mean error over position, speed, direction, load and time. A line at zero shows no "
        "dependence. The same curve in both directions indicates gravity, inertia or a spring. "
        "A difference between the directions that grows with speed indicates viscous friction; "
        "with load, load-dependent friction; with position, position-dependent friction."
    )
    return picture_section("Dependence of the error on signals", comparison.plot_errors(), note)


def picture_section(title: str, figure: Figure, note: str) -> Section:
    """Return a section of one figure.

    Parameters
    ----------
    title : str
    figure : Figure
        Embedded as PNG.
    note : str
        Explanation, shown before the figure; may be empty.
    """
    return Section(title, "picture.html", {"uri": data_uri(figure), "alt": title, "note": note})
