"""Figures of a design."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from lieid_casadi.excitation.excitation import Excitation

Array = NDArray[np.float64]
POINTS = 600


def plot(excitation: Excitation) -> Figure:
    """Return positions within limits, the path of the tool and the history of the criterion."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(12.0, 7.5), layout="constrained")
    grid = figure.add_gridspec(2, 2, width_ratios=[2.0, 1.0])
    motion = excitation.at(np.linspace(0.0, excitation.duration, POINTS))
    plot_positions(excitation, motion.t, motion.q, figure.add_subplot(grid[:, 0]))
    plot_tool_path(excitation, motion.q, figure.add_subplot(grid[0, 1], projection="3d"))
    plot_history(excitation, figure.add_subplot(grid[1, 1]))
    figure.suptitle(
        f"{excitation.model.robot.name}: condition number {excitation.condition_number:.4g}, "
        f"{excitation.duration:.4g} s",
        parse_math=False,  # "$" in a robot's name is no formula
    )
    return figure


def plot_positions(excitation: Excitation, t: Array, q: Array, ax: Axes) -> None:
    """Draw the position of each joint in parts of its range, one row per joint.

    Parameters
    ----------
    excitation : Excitation
    t : (N,)
        s.
    q : (N, n)
        rad.
    ax : Axes
    """
    robot = excitation.model.robot
    low, high = robot.limit("position_lower"), robot.limit("position_upper")
    low = np.where(np.isfinite(low), low, q.min(axis=0))
    high = np.where(np.isfinite(high), high, q.max(axis=0))
    for j in range(robot.n):
        share = (q[:, j] - low[j]) / max(high[j] - low[j], 1e-9)
        row = robot.n - 1 - j
        ax.fill_between([t[0], t[-1]], row + 0.06, row + 0.94, color="0.93", linewidth=0)
        ax.plot(t, row + 0.06 + 0.88 * share, linewidth=1.4)
    for edge in {excitation.start, excitation.end} - {0.0, excitation.duration}:
        ax.axvline(edge, color="0.4", linestyle=":", linewidth=1.0)
    ax.set_yticks(np.arange(robot.n) + 0.5, [f"q{j}" for j in range(robot.n, 0, -1)])
    ax.set_ylim(0.0, robot.n)
    ax.set_xlim(t[0], t[-1])
    ax.set_xlabel("time, s")
    ax.set_title("positions; grey: range of the joint")


def plot_tool_path(excitation: Excitation, q: Array, ax: Axes) -> None:
    """Draw the path of the tool in the base frame.

    Parameters
    ----------
    excitation : Excitation
    q : (N, n)
        rad.
    ax : Axes
        Three-dimensional.
    """
    path = tool_path(excitation, q)
    ax.plot(*path.T, linewidth=1.0)
    ax.plot(*path[:1].T, marker="o", markersize=5, linestyle="", color="black")
    ax.set_title("tool, base frame (m); dot: rest pose")
    ax.set_aspect("equal")


def tool_path(excitation: Excitation, q: Array) -> Array:
    """Return the positions of the tool (N, 3) in the base frame, m."""
    import casadi as ca

    from lieid_casadi.dynamics.lie import Motion
    from lieid_casadi.dynamics.recursion import tool_in_base

    angles = ca.SX.sym("q", excitation.model.n)
    place = tool_in_base(excitation.model.robot, Motion.of(angles)).translation
    function = ca.Function("tool", [angles], [ca.densify(place)])
    return np.asarray(function(q.T).full().T)


def plot_history(excitation: Excitation, ax: Axes) -> None:
    """Draw the condition number over the iterations of the best start."""
    history = excitation.history
    numbers = np.array([step.condition_number for step in history])
    inside = np.array([step.violation <= 1e-3 for step in history])
    count = np.arange(1, len(history) + 1)
    ax.semilogy(count, numbers, color="0.6", linewidth=1.0)
    ax.semilogy(count[inside], numbers[inside], ".", markersize=3, label="within limits")
    names = [step.stage for step in history]
    changes = [k for k in range(1, len(names)) if names[k] != names[k - 1]]
    for k in changes:
        ax.axvline(k + 1, color="0.4", linestyle=":", linewidth=1.0)
    ax.set_xlabel("iteration")
    ax.set_title("condition number")
    ax.legend(loc="upper right", fontsize="small")
