"""Tables and plot of a payload estimate."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from lieid_casadi.tables import Table, make_table
from lieid_casadi.tables import html as to_html

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from lieid_casadi.payload.estimate import PayloadEstimate


def quantity_table(payload: PayloadEstimate) -> Table:
    """Return mass, centre of mass and inertia; ``*`` marks what is not identified."""
    rows = [
        (
            row["name"] + ("" if row["identified"] else " *"),
            row["value"],
            row["std"],
            *(row["interval"] or (None, None)),
            row["feasible"],
            row["unit"],
        )
        for row in payload.table()
    ]
    return make_table(
        "Payload in the tool frame; inertia about the centre of mass",
        ("", "value", "std", "95 % from", "to", "feasible", "unit"),
        rows,
    )


def error_table(payload: PayloadEstimate) -> Table:
    """Return the RMS error of each joint with and without the payload."""
    columns = (
        payload.rms_before, payload.rms_after, payload.feasible.rms_after, payload.rms_fit,
    )  # fmt: skip
    return make_table(
        f"RMS error in motion, N·m (low-pass {payload.cutoff:.3g} Hz)",
        ("joint", "fit alone", "with the payload", "feasible", "held-out error of the fit"),
        [
            (f"{j + 1} {name}", *(float(column[j]) for column in columns))
            for j, name in enumerate(payload.joint_names)
        ],
    )


def friction_table(payload: PayloadEstimate) -> Table:
    """Return the friction parameters that were identified again."""
    return make_table(
        "Friction in the loaded run",
        ("parameter", "in the fit", "change", "std", "unit"),
        [
            (f"{part.name}:{part.joint + 1}", part.fitted, part.change, part.std, part.unit)
            for part in payload.friction
        ],
    )


def not_identified(payload: PayloadEstimate) -> list[tuple[str, str]]:
    """Return the quantities that are not identified, by reason: (names, reason)."""
    by_reason: dict[str, list[str]] = {}
    for part in payload.not_identified:
        by_reason.setdefault(part.reason, []).append(part.name)
    return [(", ".join(names), reason) for reason, names in by_reason.items()]


def html(payload: PayloadEstimate) -> str:
    """Return the verdict and the quantities as HTML."""
    reasons = [f"* {names}: {reason}." for names, reason in not_identified(payload)]
    return to_html(payload.sentence, quantity_table(payload), *reasons)


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
