"""How a fit looks: a table for notebooks, a picture of how well each parameter is known."""

from __future__ import annotations

from html import escape
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from lieid_casadi.identification.fit import Fit


def html(fit: Fit) -> str:
    """Return the parameters as an HTML table."""
    cells = [
        f"<tr><td>{escape(row['expression'])}</td><td>{row['value']:.4g}</td>"
        f"<td>{'–' if row['std'] is None else format(row['std'], '.2g')}</td>"
        f"<td>{escape(row['unit'])}</td></tr>"
        for row in fit.parameter_table()
    ]
    head = "<tr><th>parameter</th><th>value</th><th>std</th><th>unit</th></tr>"
    title = escape(f"{fit.model.robot.name}: {', '.join(fit.model.effects)}")
    return f"<table><caption>{title}</caption>{head}{''.join(cells)}</table>"


def plot(fit: Fit, ax: Axes | None = None) -> Figure:
    """Draw each parameter's |value| in standard deviations, best known first."""
    from matplotlib.figure import Figure

    numbers = np.concatenate([fit.values, fit.shapes])
    with np.errstate(divide="ignore", invalid="ignore"):
        known = np.nan_to_num(np.abs(numbers) / fit.std, nan=0.0, posinf=0.0)
    order = np.argsort(-known)
    if ax is None:
        figure = Figure(figsize=(7.0, 0.18 * len(order) + 1.2), layout="constrained")
        ax = figure.subplots()
    places = np.arange(len(order))
    ax.barh(places, known[order], color="tab:blue")
    ax.axvline(3.0, color="0.4", linewidth=1.0, linestyle="--")
    ax.set_yticks(places, [fit.fitted[k].label for k in order], fontsize=6)
    ax.set_xscale("symlog", linthresh=1.0)
    ax.invert_yaxis()
    ax.set_xlabel("|value| / standard deviation (dashed: 3)")
    drawn = ax.get_figure(root=True)
    assert drawn is not None
    return drawn
