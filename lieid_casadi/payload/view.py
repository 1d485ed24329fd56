"""Table and plot of a payload estimate."""

from __future__ import annotations

from html import escape
from typing import TYPE_CHECKING

import numpy as np

from lieid_casadi.html_table import html_table, number_cell

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from lieid_casadi.payload.estimate import PayloadEstimate


def html(payload: PayloadEstimate) -> str:
    """Return the verdict and the quantities as an HTML table."""
    rows = [
        (
            f"{row['name']}{'' if row['identified'] else ' (not identified)'}",
            number_cell(row["value"], 4),
            number_cell(row["std"], 2),
            number_cell(row["feasible"], 4),
            row["unit"],
        )
        for row in payload.table()
    ]
    table = html_table(("", "value", "std", "feasible", "unit"), rows)
    return f"<p>{escape(payload.sentence)}</p>{table}"


def plot(payload: PayloadEstimate, ax: Axes | None = None) -> Figure:
    """Draw the error of each joint with the fit alone and with the payload."""
    from matplotlib.figure import Figure

    n = len(payload.joint_names)
    if ax is None:
        figure = Figure(figsize=(1.6 + 0.9 * n, 3.4), layout="constrained")
        ax = figure.subplots()
    places = np.arange(n)
    ax.bar(places - 0.2, payload.rms_before, 0.38, color="0.7", label="fit alone")
    ax.bar(places + 0.2, payload.rms_after, 0.38, color="tab:blue", label="with the payload")
    ax.hlines(
        payload.rms_fit,
        places - 0.42,
        places + 0.42,
        colors="black",
        linestyles="--",
        linewidth=1.0,
        label="the fit's own held-out error",
    )
    ax.set_xticks(places, [f"{j + 1}" for j in range(n)])
    ax.set_xlabel("joint")
    ax.set_ylabel("RMS error, N·m")
    ax.set_title(payload.sentence, fontsize=8, wrap=True)
    ax.legend(fontsize=8)
    drawn = ax.get_figure(root=True)
    assert drawn is not None
    return drawn
