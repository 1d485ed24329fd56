"""Histories of fleets whose rows are drawn, not computed from recordings."""

from datetime import date, timedelta

import numpy as np

from lieid_casadi.fleet.history import ArmEntry, History
from lieid_casadi.fleet.night_result import (
    ArmNight,
    Batch,
    Finding,
    JointError,
    NightResult,
    ParameterEstimate,
)

FIRST = date(2026, 1, 1)
STD = 0.01


def night_of(serial, k, *, fit="f"):
    day = FIRST + timedelta(days=k)
    return ArmNight(serial, day.isoformat(), f"{serial}/{day}.csv", "1", fit)


def drawn_result(random, serial, k, *, joints=2, grown=None, errors=None, findings=(), sha=None):
    """Return a night; ``grown`` and ``errors`` change Coulomb friction and error of joints."""
    parameters = [
        ParameterEstimate(
            name,
            j + 1,
            2.0 + (grown or {}).get((name, j + 1), 0.0) + STD * random.normal(),
            STD,
            unit,
        )
        for name, unit in (("coulomb.f_c", "N·m"), ("viscous.f_v", "N·m·s/rad"))
        for j in range(joints)
    ]
    rms = [
        0.1 * np.exp(0.02 * random.normal()) * (errors or {}).get(j + 1, 1.0) for j in range(joints)
    ]
    return NightResult(
        "done",
        recording_sha256=sha or f"{serial}-{k}",
        findings=tuple(
            Finding(effect, joint, change, 0.01, "N·m", 0.05, f"{effect} was found")
            for effect, joint, change in findings
        ),
        parameters=tuple(parameters),
        errors=tuple(JointError(j + 1, rms[j], 0.08, 0.1, 3.0, None) for j in range(joints)),
    )


def write_history(path, nights, arms, change=lambda serial, k: {}, *, limits=None, seed=0):
    """Write a history of ``arms`` serials; ``change`` returns arguments of `drawn_result`."""
    random = np.random.default_rng(seed)
    with History(path) as history:
        history.set_arms([ArmEntry(serial, "robot", 2, "f", limits or {}) for serial in arms])
        for k in range(nights):
            results = [drawn_result(random, serial, k, **change(serial, k)) for serial in arms]
            nights_of_arms = [night_of(serial, k) for serial in arms]
            history.add(Batch.of(list(zip(nights_of_arms, results, strict=True))))
    return path
