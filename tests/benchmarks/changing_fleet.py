"""A simulated fleet over many nights: three kinds of arms, temperatures, payloads, real changes."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from datetime import date, timedelta
from pathlib import Path

import numpy as np
from fleet.simulated_fleet import fit_of, healthy_arm, recorded, with_wear

from lieid_casadi import plant
from lieid_casadi.plant import Arm

KINDS = ("panda", "ur10e", "rail")
FIRST_NIGHT = date(2026, 1, 1)
PAYLOAD_MASS, PAYLOAD_COM = 1.0, (0.0, 0.01, 0.04)


@dataclass(frozen=True)
class RealChange:
    """A change of an arm: its name as a diagnosis reports it, joint from 1, and its size."""

    effect: str
    joint: int | None
    hide: Callable[[Arm, int], Arm]  # number of nights since it began, from 0


def real_changes() -> list[RealChange]:
    """Return the six changes that the fleet has."""
    return [
        RealChange("coulomb", 2, lambda arm, k: with_wear(arm, 1, 0.01 * (k + 1))),
        RealChange(
            "payload", None,
            lambda arm, k: arm.with_effects(plant.Payload(mass=0.8, com=(0.02, 0.0, 0.06))),
        ),
        RealChange("torque_gain", 3, lambda arm, k: arm.with_effects(plant.TorqueGain(2, 0.05))),
        RealChange(
            "encoder_offset", 3, lambda arm, k: arm.with_effects(plant.EncoderOffset(2, 0.02))
        ),
        RealChange(
            "position_friction", 4,
            lambda arm, k: arm.with_effects(
                plant.PositionFriction(
                    3, amplitude=0.35 * float(arm.friction.coulomb[3]), harmonic=2.0, phase=0.7
                )
            ),
        ),
        RealChange(
            "base_tilt", None,
            lambda arm, k: arm.with_effects(plant.BaseTilt(about_x=0.015, about_y=-0.01)),
        ),
    ]  # fmt: skip


@dataclass(frozen=True)
class SimulatedArm:
    """One arm of the fleet and what happens to it."""

    serial: str
    kind: str
    seed: int
    records_temperature: bool
    has_payloads: bool
    change: RealChange | None
    first_changed: int  # number of the night, from 0


def arms_of(count: int, nights: int, *, seed: int = 0) -> list[SimulatedArm]:
    """Return the arms; the changes are spread over the kinds and begin after a third."""
    random = np.random.default_rng([seed, 40])
    changes = real_changes()
    changed = random.choice(count, min(len(changes), count), replace=False)
    arms = []
    for k in range(count):
        position = np.flatnonzero(changed == k)
        change = changes[int(position[0])] if len(position) else None
        kind = KINDS[k % 3]
        if change is not None and change.effect == "encoder_offset" and kind == "rail":
            kind = "panda"
        arms.append(
            SimulatedArm(
                f"{kind[0].upper()}{k + 1:02d}", kind, k + 1,
                bool(random.random() < 0.7), bool(random.random() < 0.3), change,
                int(random.integers(max(nights // 3, 5), max(nights // 2, 6))),
            )
        )  # fmt: skip
    return arms


def with_temperature(arm: Arm, mean: float) -> Arm:
    """Return an arm at a temperature; its friction falls when it is warm."""
    effects = [
        plant.TemperatureFriction(j, viscous_decay=0.008, dry_slope=0.002) for j in range(arm.n)
    ]
    warm = replace(arm, thermal=plant.Thermal(start=mean, rise=1.0, time_constant=20.0))
    return warm.with_effects(*effects)


def nights_of(arm: SimulatedArm, nights: int, duration: float):
    """Yield the recordings of an arm, night by night."""
    random = np.random.default_rng([arm.seed, 41])
    motion, remaining = int(random.integers(10**6)), int(random.integers(5, 13))
    slow = random.uniform(0, 2 * np.pi)
    for k in range(nights):
        if remaining == 0:
            motion, remaining = int(random.integers(10**6)), int(random.integers(5, 13))
        remaining -= 1
        temperature = 25.0 + 3.0 * np.sin(2 * np.pi * k / 14.0 + slow) + random.normal(0, 0.7)
        truth = with_temperature(healthy_arm(arm.kind, arm.seed), temperature)
        loaded = arm.has_payloads and random.random() < 0.4
        if loaded:
            truth = truth.with_effects(
                plant.Payload(mass=PAYLOAD_MASS, com=PAYLOAD_COM, radius=1e-6)
            )
        if arm.change is not None and k >= arm.first_changed:
            truth = arm.change.hide(truth, k - arm.first_changed)
        recording = recorded(
            arm.kind, truth, motion_seed=motion, seed=int(random.integers(2**31)),
            duration=duration, temperature=arm.records_temperature,
        )  # fmt: skip
        label = "crate" if loaded else ""
        yield replace(recording, payload_label=(label,) * len(recording))


def write_simulated_fleet(folder: Path, arms, nights: int, duration: float) -> Path:
    """Write fits, recordings and the fleet file; return its path."""
    (folder / "fits").mkdir(parents=True, exist_ok=True)
    lines = ["arms:"]
    for arm in arms:
        fit = folder / "fits" / f"{arm.serial}.json"
        if not fit.exists():
            fit_of(arm.kind, arm.seed, duration).save(fit)
        where = folder / "nights" / arm.serial
        where.mkdir(parents=True, exist_ok=True)
        paths = [where / f"{FIRST_NIGHT + timedelta(days=k)}.parquet" for k in range(nights)]
        if not all(path.exists() for path in paths):
            for path, recording in zip(paths, nights_of(arm, nights, duration), strict=True):
                recording.save(path)
        lines += [
            f"  - serial: {arm.serial}",
            f"    fit: fits/{arm.serial}.json",
            f"    recordings: nights/{arm.serial}/*.parquet",
            f"    payload: {{mass: {PAYLOAD_MASS}, com: {list(PAYLOAD_COM)}, label: crate}}",
        ]
    lines.append(r'night: "{serial}/(?P<date>\\d{4}-\\d{2}-\\d{2})"')
    path = folder / "fleet.yaml"
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return path
