"""Simulation error per joint."""

from __future__ import annotations

from lieid_casadi.report.section import Section, table_section
from lieid_casadi.simulation import WindowDrift
from lieid_casadi.simulation.view import window_table


def simulation_section(drift: WindowDrift) -> Section:
    """Return how far the simulated motion leaves the measured one, or why it is not simulated."""
    sentences = [f"Not simulated: {drift.reason}."] if drift.reason else []
    return table_section("Simulation error per joint", window_table(drift), sentences=sentences)
