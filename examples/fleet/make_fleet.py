"""A fleet of simulated arms over some nights, to try `lieid fleet` on: takes about a minute.

    python examples/fleet/make_fleet.py demo-fleet
    lieid fleet demo-fleet/fleet.yaml -o demo-fleet/history.duckdb --night 2026-01-12
    lieid fleet report demo-fleet/history.duckdb --html demo-fleet/report.html

Arm A2 wears on joint 2 from the fifth night on, a body is left on the tool of A3 from the eighth,
and A4 does not record the last two nights.
"""

import sys
from dataclasses import replace
from datetime import date, timedelta
from pathlib import Path

import numpy as np

import lieid_casadi as lieid
from lieid_casadi import plant

ROBOT = lieid.robots.two_link()
FIRST, NIGHTS, SECONDS = date(2026, 1, 1), 12, 15.0


def recording(arm, *, motion, seed):
    path = plant.FourierTrajectory(ROBOT, base_frequency=1.0 / SECONDS, seed=motion)
    t = np.arange(0.0, SECONDS, 0.002)
    sensors = plant.demo_sensors(ROBOT, rate=100.0)
    return plant.measure_along(arm, t, *path.at(t), sensors=sensors, seed=seed)


def worn(arm, part):
    dry = np.array(arm.friction.coulomb)
    dry[1] *= 1.0 + part
    return replace(arm, friction=replace(arm.friction, coulomb=dry))


def arm_on(arm, serial, night):
    if serial == "A2":
        return worn(arm, 0.03 * max(night - 3, 0))
    if serial == "A3" and night >= 7:
        return arm.with_effects(plant.Payload(mass=0.8, com=(0.02, 0.0, 0.06)))
    return arm


def make_fleet(folder):
    """Write fits, nights and the fleet file into a folder."""
    lines = ["arms:"]
    for k, serial in enumerate(("A1", "A2", "A3", "A4"), start=1):
        arm = plant.demo_arm(ROBOT, seed=k, hidden=None)
        train = [recording(arm, motion=90 + m, seed=1000 * k + m) for m in range(2)]
        fit = lieid.identify(lieid.Model(ROBOT, "coulomb,viscous,offset"), train)
        fit.save(folder / "fits" / f"{serial}.json")
        (folder / "nights" / serial).mkdir(parents=True, exist_ok=True)
        for night in range(NIGHTS - 2 * (serial == "A4")):
            run = recording(arm_on(arm, serial, night), motion=night // 4, seed=100 * k + night)
            run.save(folder / "nights" / serial / f"{FIRST + timedelta(days=night)}.csv")
        lines += [
            f"  - serial: {serial}",
            f"    fit: fits/{serial}.json",
            f"    recordings: nights/{serial}/*.csv",
            "    limits: {coulomb: 6.0}",
        ]
    lines.append(r'night: "{serial}/(?P<date>\\d{4}-\\d{2}-\\d{2})"')
    (folder / "fleet.yaml").write_text("\n".join(lines) + "\n", encoding="utf-8")


if __name__ == "__main__":
    make_fleet(Path(sys.argv[1] if len(sys.argv) > 1 else "demo-fleet"))
