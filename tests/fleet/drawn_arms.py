"""Arms in which nothing changes: their nights are drawn from a statistical model.

The model has what the plant's nights have: scatter with heavy tails, a share of every motion, a
temperature that varies over two weeks and is recorded on part of the arms, and rare findings.
"""

from __future__ import annotations

from datetime import date, timedelta

import numpy as np

from lieid_casadi.fleet.arm_history import ERROR, LEAST_ERROR_SCATTER, ArmHistory, Quantity
from lieid_casadi.fleet.changes import NightSeries
from lieid_casadi.fleet.night_result import Finding

FIRST = date(2026, 1, 1)
TAILS = 8  # degrees of freedom of the scatter's t distribution
CYCLE, CYCLE_SIZE, DAILY = 14.0, 3.0, 0.7  # days, °C, °C
BETWEEN = 0.7  # of motions, in units of the scatter
RECORDED = 0.7  # part of the arms that record temperatures
FINDINGS = 0.002  # per coefficient and night
NAMES = ("coulomb.f_c", "viscous.f_v", "offset.f_b")


def drawn_arm(random, serial, nights, slopes) -> ArmHistory:
    """Return an arm; ``slopes`` over temperature (3, joints) in scales per °C."""
    joints = slopes.shape[1]
    days = np.array([(FIRST + timedelta(days=k)).toordinal() for k in range(nights)], dtype=float)
    motions = np.cumsum(random.random(nights) < 1.0 / 8.0)
    phase = random.uniform(0.0, 2.0 * np.pi)
    warmth = CYCLE_SIZE * np.sin(2.0 * np.pi * days / CYCLE + phase)
    warmth += DAILY * random.normal(size=nights)
    recorded = 25.0 + warmth if random.random() < RECORDED else np.full(nights, np.nan)
    found: list[dict[tuple[str, int | None], Finding]] = [{} for _ in range(nights)]
    series, units = {}, {}
    for j in range(joints):
        for name, slope in zip(NAMES, slopes[:, j], strict=True):
            size = np.exp(0.2 * random.normal())
            scale = 0.01 * np.exp(0.3 * random.normal(size=motions.max() + 1))[motions]
            noise = random.standard_t(TAILS, nights) + BETWEEN * random.normal(size=nights)[motions]
            values = 2.0 + scale * size * noise + 0.01 * slope * warmth
            quantity = Quantity(name, j + 1)
            series[quantity] = NightSeries(days, values, scale, recorded, motions)
            units[quantity] = "N·m"
            for k in np.flatnonzero(random.random(nights) < FINDINGS):
                found[k][quantity.effect, j + 1] = Finding(
                    quantity.effect, j + 1, 0.1, 0.01, "N·m", 0.02, "found"
                )
        error = LEAST_ERROR_SCATTER * 2.0 * random.standard_t(TAILS, nights)
        series[Quantity(ERROR, j + 1)] = NightSeries(
            days, error, np.full(nights, LEAST_ERROR_SCATTER), np.full(nights, np.nan), motions
        )
        units[Quantity(ERROR, j + 1)] = "1"
    return ArmHistory(
        serial, "robot", joints, tuple(FIRST + timedelta(days=k) for k in range(nights)), series,
        units, tuple(found), np.zeros(nights), {}, {},
    )  # fmt: skip


def drawn_fleet(random, arms, nights, *, joints=2, largest_slope=0.8) -> list[ArmHistory]:
    """Return arms of one kind; the slopes of their joints reach ``largest_slope`` scales per °C."""
    slopes = random.uniform(0.0, largest_slope, size=(len(NAMES), joints)) * [[1.0], [1.0], [0.1]]
    return [drawn_arm(random, f"A{k:02d}", nights, slopes) for k in range(arms)]
