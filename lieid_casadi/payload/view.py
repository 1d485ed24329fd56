"""How a payload looks: a table for notebooks, and the error's fall joint by joint."""

from __future__ import annotations

from html import escape
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from lieid_casadi.payload.estimate import PayloadEstimate


def html(payload: PayloadEstimate) -> str:
    """Return the verdict and the quantities as an HTML table."""

    def cell(value: float | None, digits: int) -> str:
        return "<td>–</td>" if value is None else f"<td>{value:.{digits}g}</td>"

    rows = [
        f"<tr><td>{row['name']}{'' if row['told'] else ' (not told)'}</td>"
        f"{cell(row['value'], 4)}{cell(row['std'], 2)}{cell(row['feasible'], 4)}"
        f"<td>{row['unit']}</td></tr>"
        for row in payload.table()
    ]
    head = "<tr><th></th><th>value</th><th>std</th><th>feasible</th><th>unit</th></tr>"
    return f"<p>{escape(payload.sentence)}</p><table>{head}{''.join(rows)}</table>"


def plot(payload: PayloadEstimate, ax: Axes | None = None) -> Figure:
    """Draw each joint's error by the fit alone, with the payload, and what the fit itself had."""
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
