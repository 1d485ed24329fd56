"""Nights of simulated arms, as files that a fleet file names."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
from hidden_effects.arms import load_arm

import lieid_casadi as lieid
from lieid_casadi import plant

EFFECTS = "coulomb,viscous,offset"


def robot_named(name):
    return lieid.robots.two_link() if name == "two_link" else load_arm(name)


@cache
def healthy_arm(name, seed):
    return plant.demo_arm(robot_named(name), seed=seed, hidden=None)


@cache
def motion(name, seed, duration):
    return plant.FourierTrajectory(robot_named(name), base_frequency=1.0 / duration, seed=seed)


def recorded(name, arm, *, motion_seed, seed, duration=30.0, temperature=False):
    """Return a recording of an arm."""
    path = motion(name, motion_seed, duration)
    t = np.arange(0.0, duration, 0.002)
    sensors = replace(plant.demo_sensors(robot_named(name), rate=100.0), temperature=temperature)
    return plant.measure_along(arm, t, *path.at(t), sensors=sensors, seed=seed)


@cache
def fit_of(name, seed, duration=30.0):
    """Return the fit of a healthy arm from two recordings."""
    arm = healthy_arm(name, seed)
    runs = [
        recorded(name, arm, motion_seed=1000 + k, seed=1000 * seed + k, duration=duration)
        for k in range(2)
    ]
    return lieid.identify(lieid.Model(robot_named(name), EFFECTS), runs)


def with_wear(arm, joint, part):
    """Return an arm whose Coulomb friction has grown by a part on one joint."""
    grown = np.array(arm.friction.coulomb)
    grown[joint] *= 1.0 + part
    return replace(arm, friction=replace(arm.friction, coulomb=grown))


def write_fleet(folder, serials, **entries):
    """Write a fleet file for arms whose recordings are in ``nights/SERIAL/DATE.csv``."""
    lines = ["arms:"]
    for serial in serials:
        lines += [
            f"  - serial: {serial}",
            f"    fit: fits/{serial}.json",
            f"    recordings: nights/{serial}/*.csv",
            *(f"    {key}: {value}" for key, value in entries.items()),
        ]
    lines.append(r'night: "{serial}/(?P<date>\\d{4}-\\d{2}-\\d{2})"')
    path = Path(folder) / "fleet.yaml"
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return path


def tcp_cluster(workers):
    """Return a Dask cluster in this process, at a TCP address."""
    from distributed import LocalCluster

    return LocalCluster(
        n_workers=workers,
        threads_per_worker=1,
        processes=False,
        protocol="tcp",
        host="127.0.0.1",
        dashboard_address="127.0.0.1:0",
    )
