"""The payload at the tool."""

from __future__ import annotations

from typing import TYPE_CHECKING

from lieid_casadi.payload.view import not_identified
from lieid_casadi.report.section import Section
from lieid_casadi.report.sections.parameters import value_text
from lieid_casadi.report.sections.pictures import picture_section

if TYPE_CHECKING:
    from lieid_casadi.payload import PayloadEstimate


def payload_verdict_section(payload: PayloadEstimate) -> Section:
    """Return the answer in one sentence."""
    note = ""
    if payload.friction:
        note = "Coulomb and viscous friction and offsets were identified again from the loaded run."
    return Section("", "verdict.html", {"sentence": payload.sentence, "note": note})


def payload_section(payload: PayloadEstimate) -> Section:
    """Return the table of quantities, and those that cannot be identified."""
    rows = []
    for row in payload.table():
        value, std, interval = row["value"], row["std"], row["interval"] or (None, None)
        cells = ["–" if value is None else value_text(value, std)]
        cells += ["–" if std is None else f"{std:.2g}"]
        cells += ["–" if end is None else f"{end:.4g}" for end in interval]
        cells += [f"{row['feasible']:.4g}"]
        rows.append({**row, "cells": cells})
    parts = [{"names": names, "reason": reason} for names, reason in not_identified(payload)]
    return Section("Payload", "payload.html", {"rows": rows, "parts": parts})


def payload_picture_section(payload: PayloadEstimate) -> Section:
    """Return the error of each joint with and without the payload."""
    note = (
        "RMS error in motion, measured and predicted through the same filter: with the fit alone, "
        "and with the payload added and nothing else changed."
    )
    return picture_section("Error per joint", payload.plot(), note)
