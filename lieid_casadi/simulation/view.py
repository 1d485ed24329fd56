"""Table and figure of a simulation."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from lieid_casadi.tables import Table, make_table

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from lieid_casadi.simulation.simulation import Simulation
    from lieid_casadi.simulation.window_drift import WindowDrift

INPUTS = {"command": "commanded positions", "torque": "torques"}


def drift_table(simulation: Simulation) -> Table:
    """Return the drift of each joint, in degrees."""
    s = simulation
    columns = (s.drift.rms, s.drift.p95, s.rms_whole)
    rows = [
        (f"{j + 1} {name}", *(_degrees(column[j]) for column in columns))
        for j, name in enumerate(s.joint_names)
    ]
    return make_table(
        f"Simulated − measured position, deg, under the recorded {INPUTS[s.under]}",
        ("joint", f"RMS after {s.window:g} s", "95 %", "RMS over whole segments"),
        rows,
        note="after a window from a measured state; whole segments from their first state",
    )


def window_table(drift: WindowDrift) -> Table:
    """Return the drift of each joint within short windows, in degrees; empty if there is none."""
    rows = [
        (f"{j + 1} {name}", _degrees(rms), _degrees(p95))
        for j, (name, rms, p95) in enumerate(
            zip(drift.joint_names, drift.drift.rms, drift.drift.p95, strict=True)
        )
    ]
    return make_table(
        f"Simulated − measured position, deg, {drift.window:g} s after a measured state",
        ("joint", "RMS", "95 %"),
        () if drift.reason else rows,
        note=f"{drift.windows} windows under the recorded {INPUTS.get(drift.under, '')}; more by "
        "lieid simulate",
    )


def effects_table(simulation: Simulation) -> Table:
    """Return the drift of each joint of the models without one effect of the fit, in degrees."""
    s = simulation
    trained = ", ".join(r.name or "recording" for r in s.refitted_to)
    rows = [
        (name, *(_degrees(angle) for angle in drift.rms))
        for name, drift in (("none", s.refitted or s.drift), *s.without)
    ]
    return make_table(
        f"RMS after {s.window:g} s, deg, of models without one effect, identified from {trained}",
        ("without", *(f"joint {j + 1}" for j in range(len(s.joint_names)))),
        rows if s.without else (),
        note="–: no physically consistent model, or its motion left every range",
    )


def _degrees(angle: float) -> float | None:
    return float(np.degrees(angle)) if np.isfinite(angle) else None


def draw(simulation: Simulation, ax: Axes | None = None) -> Figure:
    """Draw the RMS drift per joint and return the figure."""
    from matplotlib.figure import Figure

    s = simulation
    if ax is None:
        ax = Figure(figsize=(1.8 + 0.9 * len(s.joint_names), 3.4), layout="constrained").subplots()
    places = np.arange(1, len(s.joint_names) + 1)
    for k, (name, drift) in enumerate(s.without):
        ax.plot(places, np.degrees(drift.rms), "o", mfc="none", color=f"C{k + 1}",
                label=f"without {name}")  # fmt: skip
    ax.plot(places, np.degrees(s.drift.rms), "D", color="black", label="model")
    ax.set_yscale("log")
    ax.set_xticks(places)
    ax.set_xlabel("joint")
    ax.set_ylabel(f"RMS drift after {s.window:g} s, deg")
    ax.legend(fontsize="small")
    drawn = ax.get_figure(root=True)
    assert drawn is not None
    return drawn
