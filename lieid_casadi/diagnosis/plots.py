"""The fall of the error, effect by effect."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from lieid_casadi.diagnosis.diagnosis import Diagnosis


def plot_waterfall(d: Diagnosis, ax: Axes | None = None) -> Figure:
    """Draw each joint's error over its noise floor, from the first model to the last."""
    from matplotlib.figure import Figure

    if ax is None:
        figure = Figure(figsize=(1.6 + 1.5 * len(d.joint_names), 3.6), layout="constrained")
        ax = figure.add_subplot()
    else:
        figure = ax.get_figure(root=True)  # type: ignore[assignment]
    tested = d.baseline_test is not None
    series = [d.baseline_test if tested else d.baseline_train]
    series += [step.rms_test if tested else step.rms_train for step in d.steps]
    known = np.array([values for values in series if values is not None], dtype=float)
    labels = ["first model", *(f"+ {step.label}" for step in d.steps)]
    width = 0.8 / max(len(known), 1)
    for k, values in enumerate(known):
        at = np.arange(len(values)) - 0.4 + (k + 0.5) * width
        shade = 0.75 - 0.6 * k / max(len(known) - 1, 1)
        ax.bar(
            at, values / known[0], width, label=labels[k], color=(shade, shade, 1.0 - 0.4 * shade)
        )
    if len(known):
        for j, floor in enumerate(d.noise_floor / known[0]):
            ax.plot([j - 0.4, j + 0.4], [floor, floor], "k--", linewidth=1.0)
    ax.set_xticks(range(len(d.joint_names)), [f"{j + 1}" for j in range(len(d.joint_names))])
    ax.set_xlabel("joint (dashed: noise floor)")
    ax.set_ylabel(f"RMS error on the {'test' if tested else 'training'}, first model = 1")
    ax.legend(fontsize="small", ncols=2)
    return figure
