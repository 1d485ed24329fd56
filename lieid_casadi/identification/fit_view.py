"""Views of a fit: tables, and a plot of the parameters' uncertainty."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from lieid_casadi.tables import Table, html, make_table

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from lieid_casadi.identification.fit import Fit


def parameter_table(fit: Fit) -> Table:
    """Return the fitted parameters with their standard deviations."""
    rows = [
        (
            row["expression"],
            row["value"],
            row["std"],
            100.0 * row["std"] / abs(row["value"]) if row["value"] and row["std"] else None,
            row["unit"],
        )
        for row in fit.parameter_table()
    ]
    shapes = f" and {len(fit.shapes)} shape parameters" if len(fit.shapes) else ""
    title = (
        f"{fit.model.robot.name}: {fit.model.base.count} base parameters{shapes}, method "
        f"{fit.method}, effects {', '.join(fit.model.effects) or 'none'}"
    )
    return make_table(title, ("parameter", "value", "std", "std %", "unit"), rows)


def html_view(fit: Fit) -> str:
    """Return the parameters as HTML."""
    return html(parameter_table(fit))


def plot_parameters(fit: Fit, ax: Axes | None = None) -> Figure:
    """Draw each parameter's |value| in standard deviations, largest first.

    Parameters
    ----------
    ax : Axes, optional
        Axes to draw into; a new figure without a window if left out.

    Returns
    -------
    Figure
    """
    from matplotlib.figure import Figure

    numbers = np.concatenate([fit.values, fit.shapes])
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        significance = np.nan_to_num(np.abs(numbers) / fit.std, nan=0.0, posinf=0.0)
    order = np.argsort(-significance)
    if ax is None:
        figure = Figure(figsize=(7.0, 0.18 * len(order) + 1.2), layout="constrained")
        ax = figure.subplots()
    places = np.arange(len(order))
    ax.barh(places, significance[order], color="tab:blue")
    ax.axvline(3.0, color="0.4", linewidth=1.0, linestyle="--")
    # names of a user's effects are not mathematical expressions
    labels = [fit.fitted[k].label.replace("$", r"\$") for k in order]
    ax.set_yticks(places, labels, fontsize=6)
    ax.set_xscale("symlog", linthresh=1.0)
    ax.invert_yaxis()
    ax.set_xlabel("|value| / standard deviation (dashed: 3)")
    drawn = ax.get_figure(root=True)
    assert drawn is not None
    return drawn
