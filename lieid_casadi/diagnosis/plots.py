"""Bar chart of the errors of successive models."""

from __future__ import annotations

from collections.abc import Sequence
from textwrap import fill
from typing import TYPE_CHECKING

import numpy as np

from lieid_casadi.arrays import Array

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

LABEL_WIDTH = 30  # characters of a line of the legend


def draw_errors(
    series: Sequence[Array],
    labels: Sequence[str],
    reference: tuple[str, Array] | None,
    recordings: str,
    ax: Axes | None = None,
) -> Figure:
    """Draw the errors (n,) of successive models relative to the first one, joint by joint.

    ``reference`` has name and values (n,) of the errors of a complete model: the noise floor.
    ``recordings`` are those on which the errors were measured: ``test``.
    """
    from matplotlib import colormaps
    from matplotlib.figure import Figure

    colours = colormaps["viridis"]
    joints = len(series[0]) if series else 0
    figure: Figure
    if ax is None:
        figure = Figure(figsize=(3.6 + 1.2 * joints, 3.6), layout="constrained")
        ax = figure.add_subplot()
    else:
        figure = ax.get_figure(root=True)  # type: ignore[assignment]
    width = 0.8 / max(len(series), 1)
    for k, values in enumerate(series):
        at = np.arange(joints) - 0.4 + (k + 0.5) * width
        colour = "0.6" if k == 0 else colours(0.15 + 0.75 * k / len(series))
        label = fill(labels[k], LABEL_WIDTH, break_long_words=False)
        ax.bar(at, values / series[0], width, label=label, color=colour)
    name, values = reference or ("", np.zeros(0))
    if series:
        for j, part in enumerate(values / series[0][: len(values)]):
            ax.plot([j - 0.4, j + 0.4], [part, part], "k--", linewidth=1.0)
    ax.set_xticks(range(joints), [f"{j + 1}" for j in range(joints)])
    ax.set_xlabel(f"joint (dashed: {name})" if name else "joint")
    ax.set_ylabel(f"RMS error on the {recordings}\nfirst model = 1".replace(", ", ",\n"))
    ax.legend(fontsize="small", loc="center left", bbox_to_anchor=(1.01, 0.5), frameon=False)
    return figure
