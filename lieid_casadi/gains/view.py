"""Table of drive gains."""

from __future__ import annotations

from typing import TYPE_CHECKING

from lieid_casadi.tables import Table, make_table

if TYPE_CHECKING:
    from lieid_casadi.gains.estimate import DriveGains

COLUMNS = ("joint", "gain", "std", "std %", "95 % from", "to", "unit")


def gain_table(gains: DriveGains) -> Table:
    """Return the gain of each joint; ``*`` marks what is not identified."""
    rows = [
        (
            f"{row['joint']} {row['name']}{'' if row['identified'] else ' *'}",
            row["gain"],
            row["std"],
            None if row["gain"] is None else 100.0 * row["std"] / abs(row["gain"]),
            *(row["interval"] or (None, None)),
            row["unit"],
            float(gains.rms_current[j]),
            float(gains.rms[j]),
        )
        for j, row in enumerate(gains.table())
    ]
    return make_table(
        f"Drive gains from a payload of {gains.mass:g} kg (low-pass {gains.cutoff:.3g} Hz)",
        (*COLUMNS, f"RMS error, {gains.per}", "N·m"),
        rows,
    )
