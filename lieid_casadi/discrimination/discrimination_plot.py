"""Figure of a discrimination: the motion and the residual torque of each pair of rivals."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from lieid_casadi.excitation.basis.trajectory import period_grid

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from lieid_casadi.discrimination.discrimination import Discrimination


def plot_discrimination(result: Discrimination, ax: Axes | None = None) -> Figure:
    """Draw the torque that each rival's refit leaves, on the joint where it is largest.

    Parameters
    ----------
    result : Discrimination
    ax : Axes, optional
        To draw into; by default a new figure, which also shows the motion.
    """
    from matplotlib.figure import Figure

    figure: Figure
    if ax is None:
        figure = Figure(figsize=(9.0, 6.0), layout="constrained")
        upper, ax = figure.subplots(2, 1, sharex=True)
        motion = result.motion(rate=100.0)
        for j in range(result.model.n):
            upper.plot(motion.t, motion.q[:, j], linewidth=1.2, label=f"q{j + 1}")
        upper.set_ylabel("position, rad")
        upper.legend(ncols=result.model.n, fontsize="small")
    else:
        figure = ax.get_figure(root=True)  # type: ignore[assignment]
    for pair in result.pairs:
        if pair.separable:
            j = int(np.argmax(np.square(pair.residual).sum(axis=0)))
            t = period_grid(result.trajectory.duration, len(pair.residual))
            label = f"{pair.true}, not explained by {pair.rival} (joint {j + 1})"
            ax.plot(t, pair.residual[:, j], linewidth=1.2, label=label)
    ax.set_xlabel("time, s")
    ax.set_ylabel("residual torque, N·m")
    ax.set_title(
        f"{result.seconds:.4g} s separate them with {100.0 * result.level:.4g} % confidence"
    )
    ax.legend(fontsize="small")
    return figure
